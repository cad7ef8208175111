"""Pages for people: what the cell did, as HTML that works without a network."""
