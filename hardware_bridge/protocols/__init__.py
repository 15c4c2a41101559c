"""Bytes on the wire: pure functions from packets to values and back; no input makes them raise."""
