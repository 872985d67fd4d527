"""Photogrammetry: survey pictures with known poses to a cloud with confidence, and a mesh."""
