"""Measuring: rates, statistics, comparisons, conditions and health, live or recorded."""
