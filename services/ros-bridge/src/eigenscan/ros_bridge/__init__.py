"""ROS 2 on Zenoh in and out, without ROS."""
