"""Dynamics given by one rule for an agent: `AgentLocal` and those built on it."""
