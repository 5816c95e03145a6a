"""What the page shows a human beside the agent, and its one button: operations that know nothing of MCP or HTTP."""
