"""Wires and other members thinner than stereo resolves, found as lines that several pictures agree on."""
