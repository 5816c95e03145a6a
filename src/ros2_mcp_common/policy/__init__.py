"""How policies are applied, alike in server and bridge: rules, checks of values, ramps and rates."""
