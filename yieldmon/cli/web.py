"""Show and operate a running daemon in a browser."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from yieldmon.bounded import why_no_file
from yieldmon.cli._daemon import add_daemon_arguments, daemon_socket
from yieldmon.errors import InputError


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "web",
        help="show and operate the daemon in a browser",
        description=f"{__doc__} Needs the extra web. Runs as its own process.",
        epilog="example: yieldmon web, then http://127.0.0.1:8090/",
    )
    add_daemon_arguments(parser)
    parser.add_argument("--store", metavar="FILE", type=Path, help="store for the history (default: the daemon's)")
    parser.add_argument(
        "--listen",
        metavar="ADDRESS:PORT",
        default="127.0.0.1:8090",
        help="address (default: 127.0.0.1:8090); one that others can reach needs --token-file",
    )
    parser.add_argument("--token-file", metavar="FILE", type=Path, help="file with the token")
    parser.add_argument("--read-only", action="store_true", help="show no buttons")
    parser.add_argument("--tiles", metavar="FILE", type=Path, help="background of the map: MBTiles of images")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when it was stopped."""
    from yieldmon.field.table import DEFAULT_FLOW_S
    from yieldmon.web.addresses import parse_listen
    from yieldmon.web.app import Sources, build_app
    from yieldmon.web.guard import Access
    from yieldmon.web.serving import check_access, own_names, serve
    from yieldmon.web.tiles import Tiles
    from yieldmon.web.tokens import read_token

    listen = parse_listen(args.listen)
    token = read_token(args.token_file) if args.token_file is not None else None
    check_access(listen, token)
    if args.store is not None and not args.store.is_file():
        raise InputError(str(args.store), why_no_file(args.store), "a daemon's store")
    sources = Sources(
        daemon=daemon_socket(args),
        store=args.store,
        configuration=Path(args.config) if args.config is not None else None,
        tiles=Tiles(args.tiles) if args.tiles is not None else None,
        flow_delay_s=DEFAULT_FLOW_S,
    )

    def ready(url: str) -> None:
        print(f"yieldmon: {url}", file=sys.stderr, flush=True)

    serve(Access(listen, token, args.read_only, own_names()), lambda access: build_app(access, sources), ready)
    return 0
