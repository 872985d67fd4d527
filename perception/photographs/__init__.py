"""Photographs that nobody rendered: what they say of themselves, which are fit, where they were taken."""
