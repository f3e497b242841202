"""One candata plug-in of each kind."""
