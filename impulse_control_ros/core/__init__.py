"""Numerical core: plant, damping, control law. No ROS, files, clock or global state."""
