"""The judge of policies: rules, checks of values, ramps and budgets, the same in server and bridge."""
