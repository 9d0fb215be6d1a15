"""Files: parameter files and bags. Only this package opens files; it does not import rclpy."""
