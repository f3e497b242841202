"""The command line: one file a command group; commands parse, call and print."""
