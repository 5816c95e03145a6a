"""What the tests stand on: clients of the server, peers in processes of their own, and sources made for the purpose."""
