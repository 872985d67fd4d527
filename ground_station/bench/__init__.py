"""Benchmarks of `swarmscan bench`: each measures one part of the installed package on given files."""
