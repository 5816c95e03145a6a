"""Sources of samples and selections from them: the live graph, bags, black boxes."""
