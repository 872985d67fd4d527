"""Finding the files that a mesh file refers to, also where it refers to another computer's disk."""

from __future__ import annotations

import io
from pathlib import Path, PureWindowsPath
from typing import Any

import PIL.Image
from trimesh.resolvers import Resolver


class Assets(Resolver):  # type: ignore[misc]
    """Serves the files beside a mesh by name, and remembers which ones were missing, moved or unreadable."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: list[str] = []
        self.moved: list[str] = []
        self.unreadable: list[str] = []

    def get(self, key: str) -> bytes:
        """Content of a file named in a mesh or material file.

        Absolute and unknown paths are looked for by their last component in the folder and below it. Raises
        FileNotFoundError.
        """
        name = key.strip().strip('"')
        path = self._find(name)
        if path is None:
            self.missing.append(name)
            raise FileNotFoundError(name)
        content = path.read_bytes()
        if path.suffix.lower() not in (".mtl", ".bin"):
            self._probe(name, content)
        return content

    def _find(self, name: str) -> Path | None:
        relative = Path(name.replace("\\", "/"))
        wanted = self.folder / relative
        inside = not relative.is_absolute() and self.folder.resolve() in wanted.resolve().parents
        if inside and wanted.is_file():
            return wanted
        last = PureWindowsPath(name).name.lower()
        for path in sorted(self.folder.rglob("*")):
            if path.name.lower() == last and path.is_file():
                self.moved.append(name)
                return path
        return None

    def _probe(self, name: str, content: bytes) -> None:
        try:
            PIL.Image.open(io.BytesIO(content)).verify()
        except (OSError, ValueError, SyntaxError):
            self.unreadable.append(name)
            raise

    def keys(self) -> list[str]:
        """Names of all files in the folder."""
        return [str(p.relative_to(self.folder)) for p in sorted(self.folder.rglob("*")) if p.is_file()]

    def namespaced(self, namespace: str) -> Assets:
        """The same for a folder below."""
        return Assets(self.folder / namespace)

    def write(self, name: str, data: Any) -> None:
        """Refused: a mesh file never writes."""
        raise PermissionError(f"{name}: importing a mesh writes no files")

    def notes(self) -> list[str]:
        """One sentence per kind of trouble."""
        told = (
            (self.missing, "missing, replaced by a procedural texture or plain colour"),
            (self.moved, "referred to elsewhere but found by name"),
            (self.unreadable, "unreadable, replaced by a procedural texture"),
        )
        return [f"{len(set(names))} files {what}: {', '.join(sorted(set(names))[:5])}" for names, what in told if names]
