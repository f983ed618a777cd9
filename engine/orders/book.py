"""The order book: one row per order, columns as lists, open orders in the order of their age."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from engine.types import NONE, OrderState


@dataclass(slots=True)
class OrderBook:
    """Columns by order number; times in ticks, NONE where it has not happened."""

    state: list[int] = field(default_factory=list)
    from_place: list[int] = field(default_factory=list)
    to_place: list[int] = field(default_factory=list)
    from_station: list[int] = field(default_factory=list)
    to_station: list[int] = field(default_factory=list)
    vehicle: list[int] = field(default_factory=list)
    created: list[int] = field(default_factory=list)
    done_at: list[int] = field(default_factory=list)
    source: list[int] = field(default_factory=list)
    open: list[int] = field(default_factory=list)  # not yet assigned, oldest first
    n_done: int = 0

    def __len__(self) -> int:
        return len(self.state)

    def add(self, tick: int, stations: tuple[int, int], places: tuple[int, int], source: int) -> int:
        """A new open order from one (station number, place) to another; returns its number."""
        self.state.append(int(OrderState.OPEN))
        self.from_station.append(stations[0])
        self.to_station.append(stations[1])
        self.from_place.append(places[0])
        self.to_place.append(places[1])
        self.vehicle.append(NONE)
        self.created.append(tick)
        self.done_at.append(NONE)
        self.source.append(source)
        self.open.append(len(self.state) - 1)
        return len(self.state) - 1

    def assign(self, order: int, vehicle: int) -> None:
        """An open order is given to a vehicle."""
        self.open.remove(order)
        self.state[order] = int(OrderState.ASSIGNED)
        self.vehicle[order] = vehicle

    def reopen(self, order: int) -> None:
        """An assigned order goes back, to its place by age."""
        self.state[order] = int(OrderState.OPEN)
        self.vehicle[order] = NONE
        self.open.append(order)
        self.open.sort()

    @property
    def unfinished(self) -> int:
        """Orders that are open, assigned or picked."""
        return sum(s in (OrderState.OPEN, OrderState.ASSIGNED, OrderState.PICKED) for s in self.state)

    def to_plain(self) -> dict[str, object]:
        """Plain values for a checkpoint."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @staticmethod
    def from_plain(plain: dict[str, object]) -> OrderBook:
        """Undo `to_plain`."""
        return OrderBook(**plain)  # type: ignore[arg-type]
