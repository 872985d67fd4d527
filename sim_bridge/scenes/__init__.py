"""True scenes: built-in structures, scenes from files, their surroundings, and the surface that can be seen of them."""
