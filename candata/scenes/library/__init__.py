"""Built-in scenes: one file each; the folder is the registry."""
