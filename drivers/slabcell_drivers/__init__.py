"""The devices of a slab-laying cell, real and simulated: cameras, robot links, lights, and a KR C4 in software."""
