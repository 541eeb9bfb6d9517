"""Associations of a scan with poses of the site: the paper's (section 5) and ours."""
