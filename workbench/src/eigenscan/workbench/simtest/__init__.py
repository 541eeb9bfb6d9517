"""A whole site in one process, on simulated time, network and disks, with faults by a seed."""
