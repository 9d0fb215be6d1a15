"""Impulse-based hybrid motion control (Ruderman, IECON 2017) for ROS 2."""

__version__ = '0.1.0'
