"""Errors that a person can act on.

SwarmscanError
├── UserError       what was typed or given is wrong; exit code 2
├── ProtocolError   a peer sent what the contract forbids; counted and refused, never obeyed
├── LinkError       a peer or the bus cannot be reached
└── DiskError       a disk does not take what must be kept
"""

from __future__ import annotations


class SwarmscanError(Exception):
    """Base of all errors raised on purpose by swarmscan."""


class UserError(SwarmscanError):
    """Bad input. The message names file, field and remedy in one sentence; the process exits with code 2."""


class ProtocolError(SwarmscanError):
    """A message that breaks the contract (unknown type, wrong version, bad hash)."""


class LinkError(SwarmscanError):
    """No session, no peer or no answer within the time allowed."""


class DiskError(SwarmscanError):
    """A disk takes no more. The message names what is not on it, and why."""
