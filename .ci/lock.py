"""Print constraints.txt: the versions in this environment of all that vpptwin[dev] needs, and of nothing else."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

HEADER = """\
# Exact versions for `make install` and CI; the ranges are in pyproject.toml.
# Regenerate from a working .venv with:  make lock"""


def collect_versions(root: Requirement) -> dict[str, str]:
    """Follow the requirements that apply here; returns package name -> public version."""
    versions: dict[str, str] = {}
    waiting, seen = [root], set()
    while waiting:
        requirement = waiting.pop()
        for extra in requirement.extras | {""}:
            key = canonicalize_name(requirement.name), extra
            if key in seen:
                continue
            seen.add(key)
            try:
                found = distribution(requirement.name)
            except PackageNotFoundError:
                raise SystemExit(f"{requirement} is not installed: run `make install` first") from None
            versions[key[0]] = Version(found.version).public  # torch 2.13.0+cpu is pinned as 2.13.0
            needed = map(Requirement, found.requires or ())
            waiting += [each for each in needed if each.marker is None or each.marker.evaluate({"extra": extra})]
    return versions


if __name__ == "__main__":
    pins = collect_versions(Requirement("vpptwin[dev]"))
    del pins["vpptwin"]
    print(HEADER, *(f"{name}=={pins[name]}" for name in sorted(pins)), sep="\n")
