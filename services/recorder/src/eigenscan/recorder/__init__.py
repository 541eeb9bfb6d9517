"""All traffic to MCAP and Rerun."""
