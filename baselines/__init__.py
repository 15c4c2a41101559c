"""Exploration strategies that act on observations alone."""
