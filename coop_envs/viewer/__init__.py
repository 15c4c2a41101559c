"""Viewer: top view, video, plots and the evaluation's report."""
