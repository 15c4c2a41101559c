"""Teams of robots in the plane: poses of three numbers, odometry, ranges and bearings, fixes."""
