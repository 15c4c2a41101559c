"""What robots measure: cameras, LED hats, IMU, wheel odometry; as data types and Warp functions."""
