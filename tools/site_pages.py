"""For mkdocs: the site's tree is the repository's, and no page is forgotten in the menu."""

from __future__ import annotations

import subprocess
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PAGE = ".md"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """All of git's files that pages can link to, by their place in the repository; the theme's own stay."""
    root = Path(config.config_file_path).parent
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    for file in [each for each in files if each.src_dir == config.docs_dir]:
        files.remove(file)
    pages = []
    for name in sorted(filter(None, listed.stdout.split("\0"))):
        if not (root / name).is_file() or name.startswith("."):
            continue
        files.append(File.generated(config, name, abs_src_path=str(root / name)))
        if name.endswith(PAGE):
            pages.append(name)
    known = str(config.nav)
    if more := [page for page in pages if f"'{page}'" not in known]:
        config.nav = [*(config.nav or []), {"More": more}]
    return files
