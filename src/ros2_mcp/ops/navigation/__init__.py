"""Navigation with Nav2: goals, planned paths, named places, and the causes of failed goals."""
