"""Sites of many robots: rights, the files of each machine, and the state of all robots."""
