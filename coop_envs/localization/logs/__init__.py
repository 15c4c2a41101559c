"""Logs of any format: CSV files, MCAP, ROS 1 bags, the UTIAS data sets; their columns, their checks, who is in them."""
