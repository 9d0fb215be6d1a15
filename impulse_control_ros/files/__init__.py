"""The only room that opens files: parameter files and bags. No rclpy."""
