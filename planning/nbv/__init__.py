"""Where to look next: candidate views, their expected gain, the search over them, and the survey's views."""
