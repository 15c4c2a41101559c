"""Evaluation and training of policies."""
