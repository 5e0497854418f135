"""YAML of anyone's, read within bounds: no code, no gigabytes, no endless references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

MOST_BYTES = 1 << 18
"""Longest file [bytes], which takes a second or two; a twin has 1 kB, metadata of a bag 100."""
MOST_NODES = 50_000
"""Values in it, those behind an alias counted as often as they are named."""


def read_yaml(path: Path) -> Any:  # noqa: ANN401
    """What a YAML file holds: mappings, lists, text, numbers.

    Raises:
        OSError: if it cannot be read.
        UnicodeDecodeError: if it is no text.
        yaml.YAMLError: if it is no YAML, longer, deeper or more often referred to than one that describes anything.
    """
    with path.open("rb") as file:
        text = file.read(MOST_BYTES + 1).decode()
    if len(text) > MOST_BYTES:
        raise yaml.YAMLError(f"longer than {MOST_BYTES} bytes")
    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if count_nodes(node, {}) > MOST_NODES:
            raise yaml.YAMLError(f"aliases make more than {MOST_NODES} values of it")
        return loader.construct_document(node)
    except RecursionError:
        raise yaml.YAMLError("nested too deeply, or in itself") from None
    except (ValueError, OverflowError, TypeError) as error:  # of dates and numbers that are none
        raise yaml.YAMLError(str(error)) from None
    finally:
        loader.dispose()


def count_nodes(node: yaml.Node, known: dict[int, int]) -> int:
    """Values below a node, itself included; `known` holds counts by identity."""
    if id(node) not in known:
        below = node.value if isinstance(node.value, list) else ()
        parts = [part for item in below for part in (item if isinstance(item, tuple) else (item,))]
        known[id(node)] = 1 + sum(count_nodes(part, known) for part in parts)
    return known[id(node)]
