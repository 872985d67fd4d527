"""Procedural families of structures: parameters drawn from a seed, kinds split into train, validation and test."""
