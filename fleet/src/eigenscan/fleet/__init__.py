"""A site of many robots: who may say what, the files of each machine, and how all are."""
