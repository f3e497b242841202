"""Built-in objects: one file each, which exports `OBJECT`; the folder is the registry."""
