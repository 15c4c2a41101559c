"""Cameras of a mission: frames from devices, files, folders, ROS or the simulator, as blobs of light."""
