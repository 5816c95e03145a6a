"""The languages of conditions, paths and field types, as agents write them and server and bridge evaluate them."""
