"""Longest priced paths of the agents, for any dynamics whose state is each agent's own."""
