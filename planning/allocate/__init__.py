"""Who takes which view, in which order: the thesis's clustering, tours, battery forecast and reassignment."""
