"""The only room that imports rclpy: the nodes translate, decode, call core, encode."""
