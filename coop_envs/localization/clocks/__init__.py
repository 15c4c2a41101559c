"""Whose time it is: clocks aligned by arrivals, or by turns that gyros feel and cameras see."""
