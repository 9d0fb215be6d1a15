"""Scripts that make pages of docs/; they are not installed."""
