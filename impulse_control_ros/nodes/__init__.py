"""The nodes: decode, call core, encode. Only this package imports rclpy."""
