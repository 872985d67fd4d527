"""The page that explains a flight, and the numbers on it."""
