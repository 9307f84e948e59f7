"""Hooks of MkDocs: pages from outside docs/, the API reference, links that leave the site, and a check for network use."""

from __future__ import annotations

import posixpath
import re
import tomllib
from pathlib import Path
from typing import Any

from api_pages import PACKAGES, public_modules, room_page, rooms
from document_links import links, resolve
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REPOSITORY = PROJECT["urls"]["Source"]
# Documents in the repository's root that are pages of the site, with their names there.
ROOT_PAGES = {
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "THIRD_PARTY.md": "third_party.md",
}
API = "API reference"
PROJECT_PAGES = "Project"
LOADED = re.compile(
    r"""<(?:script|img|iframe|source|link)\b(?![^>]*\brel="(?:canonical|next|prev)")[^>]*?"""
    r"""\b(?:src|href)=["']?(?P<html>(?:https?:)?//[^"'\s>]+)|@import\s+["'](?P<css>(?:https?:)?//[^"']+)"""
    r"""|url\(["']?(?P<url>(?:https?:)?//[^"')]+)"""
)


def on_config(config: Any) -> Any:
    """List the rooms and the repository in the navigation.

    The theme's own `repo_url` is not set, because every page would then ask the forge for the number of stars.
    """
    config.site_description = PROJECT["description"]
    for entry in config.nav:
        if API in entry:
            for package in PACKAGES:
                names = [{room.name: room.page} for room in rooms(ROOT, package)]
                entry[API].append({f"{package}: all modules": names})
    config.nav[-1][PROJECT_PAGES].append({"Source code": REPOSITORY})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are outside docs/."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text(encoding="utf-8")))
    public = public_modules(ROOT)
    for package in PACKAGES:
        for room in rooms(ROOT, package):
            files.append(File.generated(config, room.page, content=room_page(room, public)))
    return files


def on_page_markdown(markdown: str, page: Any, files: Any, **_: Any) -> str:
    """Convert links between documents of the repository to links of the site or to links to the repository."""
    here = page.file.src_uri
    source = {site: name for name, site in ROOT_PAGES.items()}.get(here, f"docs/{here}")
    for link in reversed(links(markdown)):
        if link.external or link.target.startswith("#"):
            continue
        target = site_target(here, source, link.target, {file.src_uri for file in files})
        markdown = markdown[: link.start] + target + markdown[link.end :]
    return markdown


def site_target(here: str, source: str, target: str, pages: set[str]) -> str:
    """Target of a link on the site; a broken link is left as written, so that MkDocs reports it."""
    path, anchor = resolve(source, target)
    suffix = f"#{anchor}" if anchor else ""
    page = ROOT_PAGES.get(path, path.removeprefix("docs/") if path.startswith("docs/") else "")
    if page in pages:
        return posixpath.relpath(page, posixpath.dirname(here) or ".") + suffix
    place = ROOT / path
    if not place.exists() or not place.resolve().is_relative_to(ROOT):
        return target
    return f"{REPOSITORY}/{'tree' if place.is_dir() else 'blob'}/main/{path}{suffix}"


def on_post_build(config: Any) -> None:
    """Refuse a site that loads anything from the network."""
    loaded = []
    for path in sorted(Path(config.site_dir).rglob("*")):
        if path.suffix in {".html", ".css"}:
            addresses = (
                match.group(match.lastgroup or 0) for match in LOADED.finditer(path.read_text(encoding="utf-8"))
            )
            loaded += [f"{path.relative_to(config.site_dir)}: {address}" for address in addresses]
    if loaded:
        raise PluginError("the site would load from the network:\n" + "\n".join(loaded[:20]))
