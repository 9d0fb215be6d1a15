"""Command lines on recordings and experiments."""
