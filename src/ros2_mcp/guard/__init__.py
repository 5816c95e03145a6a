"""Decide whether and how fast a command may be carried out: policy, approvals, latch, budgets and audit."""
