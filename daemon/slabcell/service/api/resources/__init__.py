"""What the control API offers: one module for each kind of resource, each with its list of endpoints."""
