"""Methods of next-best-view exploration under test: each sees pictures and poses, and chooses steps on the lattice."""
