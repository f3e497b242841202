"""One look at every effect: signatures rank them, simulations sharpen the best."""
