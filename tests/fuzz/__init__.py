"""Everything that reads what others wrote, given damaged and forged inputs without end."""
