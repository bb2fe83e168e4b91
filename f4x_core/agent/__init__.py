"""Agents: the tools of a Model Context Protocol server on the scenes of one folder. Needs the extra `agents` (mcp)."""
