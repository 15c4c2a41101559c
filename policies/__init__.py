"""Learned policies: networks, loading, export. Their weights come from training; none are shipped yet."""
