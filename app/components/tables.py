"""The tables: fleet, orders, chargers, events. Rows are keyed, so that an update keeps scroll, order and selection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import dash_ag_grid as dag

from app.components.basics import energy

Record = Mapping[str, Any]


def _column(name: str, field: str, **more: Any) -> dict[str, Any]:
    width = more.pop("width")  # its share of the table; no column gets narrower than three quarters of it
    size = {"flex": width, "minWidth": round(0.75 * width)}
    return {"headerName": name, "field": field, "headerTooltip": more.pop("tip", name), **size, **more}


def _formatted(name: str, field: str, function: str, **more: Any) -> dict[str, Any]:
    return _column(name, field, valueFormatter={"function": f"{function}(params.value)"}, type="rightAligned", **more)


def _grid(
    grid_id: str, columns: list[dict[str, Any]], *, nothing: str, selectable: bool = False, **more: Any
) -> dag.AgGrid:
    options: dict[str, Any] = {
        "animateRows": False,
        "localeText": {"noRowsToShow": nothing},
        "suppressCellFocus": False,
        "enableCellTextSelection": True,
        "tooltipShowDelay": 400,
        "theme": {"function": "themeQuartz"},
    }
    if selectable:
        options["rowSelection"] = {"mode": "singleRow", "checkboxes": False, "enableClickSelection": True}
    return dag.AgGrid(
        id=grid_id,
        columnDefs=columns,
        rowData=[],
        getRowId="params.data.key",
        defaultColDef={"sortable": True, "resizable": True, "suppressMovable": True},
        dashGridOptions=options,
        className="wl-grid",
        style={"height": "100%", "width": "100%"},
        **more,
    )


def fleet_grid(grid_id: str, levels: Mapping[str, float]) -> dag.AgGrid:
    """Columns of RunView.fleet; the charging levels are ticks on the bar of charge."""
    columns = [
        _column("AGV", "vehicle", width=70, maxWidth=80),
        _column("State", "state", cellRenderer="StateCell", width=120),
        _column("Task", "task", width=100, minWidth=92),
        _formatted("Order", "order", "wlNone", width=75),
        _column("At", "place_name", width=90),
        _column("Charge", "soc", cellRenderer="SocBar", cellRendererParams={"levels": dict(levels)}, width=170),
        _column("Why waiting", "why", tooltipField="why", width=260),
        _formatted("Waited", "waiting_s", "wlSpan", width=85, tip="Waiting so far"),
        _formatted("Energy", "energy_j", "wlEnergy", width=95, tip="Drawn from the battery so far"),
        _formatted("Distance", "distance_m", "wlMetres", width=95),
        _formatted("Done", "orders_done", "wlNone", width=70, tip="Orders done"),
    ]
    return _grid(grid_id, columns, selectable=True, nothing="No vehicles")


def orders_grid(grid_id: str) -> dag.AgGrid:
    columns = [
        _column("Order", "order", width=80),
        _column("State", "state", width=100),
        _column("From", "from_name", width=80),
        _column("To", "to_name", width=80),
        _column("AGV", "vehicle", cellRenderer="VehicleCell", width=70),
        _formatted("Created", "created_s", "wlClock", width=100),
        _formatted("Assigned", "assigned_s", "wlClock", width=100),
        _formatted("Picked", "picked_s", "wlClock", width=100),
        _formatted("Done", "done_s", "wlClock", width=100),
        _formatted("Age", "age_s", "wlSpan", width=85),
        _column("Given by", "source", width=100),
        _column("", "command_text", cellRenderer="CommandCell", width=100, sortable=False),
    ]
    return _grid(grid_id, columns, nothing="No orders yet")


def chargers_grid(grid_id: str) -> dag.AgGrid:
    columns = [
        _column("Charger", "name", width=90),
        _column("State", "state", width=120),
        _column("AGV", "vehicle", cellRenderer="VehicleCell", width=80),
        _formatted("Since", "since_s", "wlClock", width=100),
        _column("Charge", "soc", cellRenderer="SocBar", width=170),
        _column("On their way", "bookings_text", width=160, tip="Vehicles that have booked it"),
        _column("Queue", "queue_text", width=160, tip="Vehicles that wait for it"),
        _column("", "command_text", cellRenderer="CommandCell", width=130, sortable=False),
    ]
    return _grid(grid_id, columns, nothing="This floor has no chargers")


def events_grid(grid_id: str) -> dag.AgGrid:
    """Events: a click selects the row; a double click or Enter goes to its time and place."""
    columns = [
        _formatted("Time", "time_s", "wlClock", width=95, minWidth=86, maxWidth=110),
        _column("Level", "level_word", width=100, maxWidth=120),
        _column("Kind", "kind", width=140, maxWidth=180),
        _column("AGV", "vehicle", cellRenderer="VehicleCell", width=80, maxWidth=90),
        _column("What", "text", width=500, tip="Double-click, or press Enter, to go to its time and place"),
    ]
    going = {name: ["wlGoToEvent(params)"] for name in ("cellDoubleClicked", "cellKeyDown")}
    return _grid(grid_id, columns, selectable=True, nothing="No events yet", eventListeners=going)


def ways_grid(grid_id: str) -> dag.AgGrid:
    """Ways that the search of a robot on terrain has published."""
    columns = [
        _formatted("Time", "time_s", "wlClock", width=95, minWidth=86, maxWidth=110),
        _column("Why", "why", width=170),
        _column("Bound", "bound", width=190, tip="What the way costs at most, of the least"),
        _column("Cost of the way ahead", "cost", width=160, type="rightAligned"),
        _column("Expanded", "expanded", width=110, type="rightAligned", tip="States expanded for it"),
        _column("In all", "total", width=110, type="rightAligned", tip="States expanded until then"),
        _column("OPEN", "open", width=100, type="rightAligned", tip="States left in OPEN"),
        _column("INCONS", "incons", width=100, type="rightAligned", tip="States left in INCONS: for the next pass"),
    ]
    return _grid(grid_id, columns, nothing="No way is published yet")


def way_rows(passes: Mapping[str, Any], objective: str) -> list[dict[str, Any]]:
    """Rows of ways_grid from engine.results.ground.Ground.passes, newest first."""
    rows, total = [], 0
    for i, time_s in enumerate(passes["t_s"].tolist()):
        bound, cost = float(passes["bound"][i]), float(passes["cost"][i])
        total += int(passes["expanded"][i])
        known = bound == bound  # not NaN
        words = "no way is known" if not known else "optimal" if bound <= 1 else f"≤ {bound:g} × of the least"
        rows.append(
            {
                "key": str(i),
                "time_s": time_s,
                "why": "repaired" if passes["repaired"][i] else "anew" if passes["anew"][i] else "bettered",
                "bound": words,
                "cost": "–" if not known else f"{cost:.2f} m" if objective == "distance" else energy(cost),
                **{name: int(passes[name][i]) for name in ("expanded", "open", "incons")},
                "total": total,
            }
        )
    return rows[::-1]


ACTIVE_ORDERS = ("open", "assigned", "picked")
WITHDRAWABLE = ("open", "assigned")
LEVELS = ("info", "warning", "error")


def fleet_rows(records: Sequence[Record]) -> list[dict[str, Any]]:
    keep = (
        "vehicle", "state", "task", "order", "place_name", "soc", "why",
        "waiting_s", "energy_j", "distance_m", "orders_done",
    )  # fmt: skip
    return [{"key": str(record["vehicle"]), **{name: _short(record.get(name)) for name in keep}} for record in records]


def order_rows(records: Sequence[Record], *, live: bool) -> list[dict[str, Any]]:
    """Orders with a withdraw command while they can still be withdrawn."""
    rows = []
    for record in records:
        row = {"key": str(record["order"]), **{name: _short(value) for name, value in record.items()}}
        if live and record["state"] in WITHDRAWABLE:
            row |= {"command": {"do": "withdraw", "order": record["order"]}, "command_text": "Withdraw…"}
        rows.append(row)
    return rows


def charger_rows(records: Sequence[Record], fleet: Sequence[Record], *, live: bool) -> list[dict[str, Any]]:
    """Chargers with the charge of who is connected, names of who comes and who waits, and out / back."""
    rows = []
    for record in records:
        row = {"key": record["name"], **record}
        vehicle = record.get("vehicle")
        row["soc"] = fleet[vehicle]["soc"] if vehicle is not None and vehicle < len(fleet) else None
        row["bookings_text"] = ", ".join(str(v) for v in record.get("bookings") or ())
        row["queue_text"] = ", ".join(str(v) for v in record.get("queue") or ())
        if live:
            out = record["state"] == "out of order"
            row["command"] = {
                "do": "charger back" if out else "charger out",
                "charger": record["charger"],
                "label": record["name"],
            }
            row["command_text"] = "Back in order" if out else "Out of order…"
        rows.append(row)
    return rows


def event_rows(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Events, newest first, with a key that stays when newer ones come."""
    seen: dict[str, int] = {}
    rows = []
    for record in reversed(records):
        stem = f"{record['tick']}-{record['kind']}-{record['vehicle']}-{record['order']}-{record['place']}"
        seen[stem] = seen.get(stem, 0) + 1
        level = LEVELS[max(0, min(2, int(record["level"])))]
        rows.append({**record, "level_word": level, "key": f"{stem}-{seen[stem]}"})
    rows.reverse()
    return rows


def _short(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else value
