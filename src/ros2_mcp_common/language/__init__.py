"""The languages of conditions, paths and types of fields, as agents write them and the bridge evaluates them."""
