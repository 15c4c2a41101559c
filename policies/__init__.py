"""Learned policies: networks, the distribution of their actions, files and loading."""
