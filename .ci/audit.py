"""Look the pinned versions up in the database of known vulnerabilities; say so where that cannot be reached.

Usage: python .ci/audit.py constraints.txt

The exit status is 1 where a pinned version has a known vulnerability.
"""

from __future__ import annotations

import json
import subprocess
import sys


def main() -> int:
    """Run pip-audit, and tell what it found from what it could not look up."""
    command = [
        sys.executable,
        "-m",
        "pip_audit",
        "-r",
        sys.argv[1],
        "--no-deps",
        "--disable-pip",
        "-f",
        "json",
    ]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    try:
        found = json.loads(result.stdout)["dependencies"]
    except ValueError:
        said = result.stderr.strip().splitlines() or ["it says nothing"]
        print(f"vulnerabilities were NOT looked up: pip-audit cannot reach its database ({said[-1]})")
        return 0
    audited = [each for each in found if "skip_reason" not in each]
    for each in audited:
        for known in each["vulns"]:
            better = ", ".join(known["fix_versions"]) or "none yet"
            print(f"{each['name']} {each['version']}: {known['id']}, mended in: {better}")
    if len(audited) < len(found):
        print(f"vulnerabilities were NOT looked up for {len(found) - len(audited)} of {len(found)} packages")
        print(f"(the database does not answer for them, as: {next(s for s in _reasons(found))})")
    vulnerable = [each for each in audited if each["vulns"]]
    print(f"{len(vulnerable)} of {len(audited)} packages that were looked up have known vulnerabilities")
    return 1 if vulnerable else 0


def _reasons(found: list[dict[str, str]]) -> list[str]:
    return [each["skip_reason"] for each in found if "skip_reason" in each]


if __name__ == "__main__":
    sys.exit(main())
