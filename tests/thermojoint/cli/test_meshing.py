"""From a part of a CAD system to a mesh whose faces have names, by the commands."""

import tomllib

from repository import ROOT


def test_a_part_is_drafted_meshed_and_drawn(command, tmp_path):
    part, draft, mesh = (
        ROOT / "examples" / "clamp" / "clamp.step",
        tmp_path / "faces.toml",
        tmp_path / "part.msh",
    )
    code, out, _ = command("mesh", part, "--size-mm", "40", "--draft", draft, "--out", mesh)
    assert code == 0
    assert "bed_block" in out
    names = tomllib.loads(draft.read_text())
    assert set(names["bodies_mm"]) == {"bed", "block"}
    assert names["joints"] == {"bed_block": ["bed", "block"]}
    assert len(names["surfaces_mm"]) >= 10

    pictures = {option: tmp_path / f"{option[2:]}.png" for option in ("--out", "--faces")}
    words = [word for pair in pictures.items() for word in pair]
    code, out, _ = command("inspect", mesh, *words)
    assert code == 0
    assert all(name in out for name in names["surfaces_mm"])
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures.values())
