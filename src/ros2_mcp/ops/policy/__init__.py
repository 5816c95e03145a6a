"""Describe the policy in force for the agent; and draft a policy from the live graph."""
