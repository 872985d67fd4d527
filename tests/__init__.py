"""Tests of swarmscan."""
