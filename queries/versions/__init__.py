"""What separates the versions of a lake, and copies of them."""
