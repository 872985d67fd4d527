"""What is probably where nothing has been seen yet."""
