"""The numbers: plant, damping, control law. No ROS, no files, no clock, no global state."""
