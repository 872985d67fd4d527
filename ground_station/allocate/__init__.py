"""`swarmscan allocate` and its benchmark: views from a file, shared out among vehicles, without flying them."""
