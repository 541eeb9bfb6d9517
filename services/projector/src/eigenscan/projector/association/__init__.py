"""Which poses of the site a scan could come from: the paper's associations (section 5) and ours."""
