"""The commands `companion keys`: who is a vehicle, who may watch, who may command."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Certificates of the link: who may watch, who may command."
)

Folder = Annotated[Path, typer.Option("--authority", metavar="FOLDER", help="Of the authority that signs.")]
Out = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="New folder for what its owner needs.")]
Name = Annotated[str, typer.Argument(metavar="NAME", help="Of its owner: letters, digits, - and _.")]


@app.command()
def authority(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New folder; keep it to yourself.")],
) -> None:
    """Make an authority: the one that all vehicles and operators of a fleet trust.

    Whoever has its folder can make a certificate that commands every vehicle: keep it off vehicles and tablets.
    """
    from companion.link.authority import Authority

    Authority.make(folder)
    typer.echo(
        f"{folder}: an authority; keep it to yourself. Next: companion keys vehicle NAME --authority {folder} ..."
    )


@app.command()
def vehicle(
    name: Name,
    authority: Folder,
    out: Out,
    number: Annotated[
        int | None, typer.Option(min=1, max=255, metavar="N", help="Its number among several, fleet.number.")
    ] = None,
) -> None:
    """Make a vehicle's certificate. In its settings the name is link.name, and the number fleet.number."""
    from companion.link.authority import Authority

    Authority(authority).issue(name, "vehicle", out, number)
    numbered = "" if number is None else f", and fleet.number to {number}"
    typer.echo(f"{out}: copy it to the vehicle, and set link.certificates to it and link.name to {name}{numbered}")


@app.command()
def operator(
    name: Name,
    authority: Folder,
    out: Out,
    role: Annotated[Literal["watch", "command"], typer.Option(help="Only watch, or command too.")] = "watch",
) -> None:
    """Make an operator's certificate, for `companion ground`."""
    from companion.link.authority import Authority

    Authority(authority).issue(name, role, out)
    may = "watch and command" if role == "command" else "watch"
    typer.echo(f"{out}: {name} may {may}; copy it to the operator's computer and nowhere else")


@app.command()
def revoke(name: Name, authority: Folder) -> None:
    """Trust somebody no longer. It counts on a vehicle once the list, revoked.crl, is in its folder."""
    from companion.link.authority import Authority
    from companion.link.certificates import REVOKED

    Authority(authority).revoke(name)
    typer.echo(
        f"{name} is revoked: copy {authority / REVOKED} into the folder of certificates of each vehicle and operator. "
        "A vehicle that flies refuses commands by it at once, and cuts it off within a second"
    )


@app.command("list")
def list_(authority: Folder) -> None:
    """Print who has a certificate, what for, and which are revoked."""
    from companion.link.authority import Authority
    from companion.text_table import columns

    found = Authority(authority).issued()
    rows = [
        (
            one.name,
            one.role,
            "" if one.number is None else str(one.number),
            "revoked" if one.is_revoked else "valid",
            f"{one.serial:x}",
        )
        for one in found
    ]
    heads = ("name", "role", "number", "state", "serial")
    typer.echo("\n".join(columns([heads, *rows])) if rows else "no certificates yet")
