"""Localizing recorded teams: logs in, trajectories and how far they can be trusted out."""
