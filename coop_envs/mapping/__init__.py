"""What the team knows of the ground: proven, hazardous, blocked; and ways over it."""
