"""Endpoints on loopback for tests that open a bus."""

from __future__ import annotations

import socket


def free_endpoint() -> str:
    """A TCP endpoint on which nobody listens."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{s.getsockname()[1]}"
