"""Rotations, keyed random numbers and ray casting, as Warp functions shared by all rooms above."""
