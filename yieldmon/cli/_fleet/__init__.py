"""The words of `yieldmon fleet`, a module each with add_parser(subparsers) and run(args)."""
