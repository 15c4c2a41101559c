"""The fast physics: truth of a batch of teams, stepped by Warp kernels."""
