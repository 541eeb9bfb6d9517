"""A robot's pose for fleet managers that speak VDA 5050, and their word of where it is."""
