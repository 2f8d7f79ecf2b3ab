"""The JSON documents that other programs read: what `--json` prints, as types.

Lists are JSON arrays; `None` is `null` and stands for unknown. A key that is not always there is `NotRequired`. Keys are only
added within a major version. The schemas in ``docs/reference/schemas`` are made from these types.
"""
