"""Where samples are read from, and what of them: live graph, bags, black boxes."""
