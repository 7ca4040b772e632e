"""Decisions one after another for systems that run: `Session`, and a service around it."""

from sapopt.live.decision import Decision, Outcome
from sapopt.live.session import Session

__all__ = ["Decision", "Outcome", "Session"]
