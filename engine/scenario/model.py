"""What a scenario says, section by section: strict, frozen, every number with its unit in its name."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, field_validator

from engine.errors import BadInput, unknown_name
from engine.scenario.blocks import rows_of_blocks
from engine.types import Occupancy, StationKind
from engine.world.floor import FloorPlan
from engine.world.grid import GridMotion
from engine.world.height_files import unpacked
from engine.world.network import Arc, NetworkPlan, Node, mesh
from engine.world.relief import Terrain, generate, terrain_of
from engine.world.terrain import TerrainPlan

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Ticks = Annotated[int, Field(ge=1, le=10_000)]
StationNumber = Annotated[int, Field(ge=1)]
KindName = Literal["inbound", "outbound", "rack", "entrance", "station"]
CellXY = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]
SoC = Annotated[float, Field(gt=0, le=1)]
TERRAIN = str.maketrans({**dict.fromkeys(".GSE", "."), **dict.fromkeys("@OTW", "#")})
"""MovingAI's letters as those of a drawing: passable terrain is aisle, everything else wall."""


class Section(BaseModel):
    """Strict, frozen, no unknown keys, finite numbers only."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


class TimeSection(Section):
    tick_s: Positive = Field(default=1.0, description="Seconds per tick; every motion lasts whole ticks")
    until_s: Positive | None = Field(
        default=None, description="Simulated seconds after which the run ends; none is endless"
    )
    finish: Literal["never", "orders done", "orders done and home", "goals reached"] = Field(
        default="never", description="What ends the run before until_s"
    )


class BlocksSection(Section):
    """A generated warehouse: storage blocks between one-way aisles, two-lane main roads, stations on two sides."""

    columns: int = Field(default=4, ge=1, le=100, description="Storage blocks side by side")
    rows: int = Field(default=4, ge=1, le=100, description="Storage blocks above each other")
    block_width: int = Field(default=8, ge=1, le=100, description="Cells of a block, west to east")
    block_height: int = Field(default=2, ge=1, le=20, description="Cells of a block, south to north")
    aisle_width: Literal[1, 2] = Field(
        default=1, description="Lanes of an aisle: 1 alternates its direction, 2 runs both ways"
    )
    main_every: int = Field(default=4, ge=0, le=100, description="Blocks between two-lane main roads; 0 for none")
    racks: int = Field(default=32, ge=0, description="Racks that orders name, spread evenly over the blocks")
    inbound: int = Field(default=3, ge=0, description="Inbound stations, on the west side")
    outbound: int = Field(default=3, ge=0, description="Outbound stations, on the east side")
    exits: int = Field(
        default=0, ge=0, description="Further outbound stations at the ends of aisles, west and east, the middle first"
    )
    chargers: int = Field(default=8, ge=0, description="Chargers, on the south side, then on the north side")
    parking: int = Field(default=8, ge=0, description="Parking bays, spread evenly over the blocks")


class NodeItem(Section):
    """A node of a network; with a kind it is a station."""

    name: str = Field(min_length=1, max_length=40)
    x: float
    y: float
    kind: KindName | None = None


class ArcItem(Section):
    """A way between two nodes by their names; without a length as long as they are apart."""

    from_: str = Field(validation_alias=AliasChoices("from", "from_"), serialization_alias="from")
    to: str
    length_m: Positive | None = None
    one_way: bool = False


class MeshSection(Section):
    """A rectangular network; the outermost columns are entrances, all other nodes racks."""

    columns: int = Field(default=14, ge=2, le=200, description="Nodes from west to east")
    rows: int = Field(default=8, ge=2, le=200, description="Nodes from south to north")
    spacing_m: Positive = Field(default=0.9, le=1000, description="Length of an arc in metres")


class NetworkSection(Section):
    """A path network: a mesh, or nodes and arcs."""

    mesh: MeshSection | None = Field(default=None, description="A rectangular network")
    nodes: tuple[NodeItem, ...] = Field(default=(), description="Nodes {name, x, y, kind}, in metres")
    arcs: tuple[ArcItem, ...] = Field(default=(), description="Arcs {from, to, length_m, one_way}")
    kerbs: int = Field(default=64, ge=1, le=100_000, description="Lanes on which vehicles may rest")

    def parts(self) -> tuple[tuple[Node, ...], tuple[Arc, ...]]:
        """Nodes and arcs. Raises BadInput for an arc to an unknown node."""
        if self.mesh is not None:
            return mesh(self.mesh.columns, self.mesh.rows, self.mesh.spacing_m)
        nodes = tuple(Node(i.name, i.x, i.y, StationKind(i.kind) if i.kind else None) for i in self.nodes)
        index = {node.name: i for i, node in enumerate(nodes)}
        arcs: list[Arc] = []
        for number, item in enumerate(self.arcs, start=1):
            for name in (item.from_, item.to):
                if name not in index:
                    raise BadInput(f"arc {number}: {unknown_name('node', name, index)}")
            a, b = nodes[index[item.from_]], nodes[index[item.to]]
            length = item.length_m or ((a.x_m - b.x_m) ** 2 + (a.y_m - b.y_m) ** 2) ** 0.5
            arcs.append(Arc(index[item.from_], index[item.to], round(length * 1000), item.one_way))
        return nodes, tuple(arcs)


class TerrainSection(Section):
    """Ground outdoors, generated or from a file of heights, and what the robot knows and sees of it."""

    generator: str = Field(default="bumps", min_length=1, description="Class of terrain, when there is no map")
    seed: int = Field(default=1, ge=0, le=2**63 - 1, description="Seed of the ground; the run's seed leaves it alone")
    width_m: Positive = Field(default=60.0, le=1000, description="West to east")
    length_m: Positive = Field(default=60.0, le=1000, description="South to north")
    hills_m: NotNegative = Field(default=1.5, le=100, description="Height of the highest hills")
    hills: int = Field(default=40, ge=0, le=1000, description="Hills")
    obstacles: int = Field(default=0, ge=0, le=1000, description="Round obstacles")
    rough: int = Field(default=0, ge=0, le=1000, description="Patches of 1.5 to 2.5 times the rolling resistance")
    clear: tuple[tuple[NotNegative, NotNegative], ...] = Field(
        default=(), description="Points [[x, y], …] in metres that obstacles keep clear of"
    )
    heights: str | None = Field(default=None, description="Heights of `floor.map`, packed; in place of a generator")
    low_m: float = Field(default=0.0, description="Height of black in a PNG")
    high_m: float = Field(default=2.0, description="Height of white in a PNG")
    slope_limit_deg: float = Field(default=30.0, gt=0, lt=90, description="Steeper ground is not driven on")
    cluster: Literal["figure4", "medium", "dense"] = Field(default="figure4", description="Trajectories per heading")
    turn_rate_deg: Positive = Field(default=22.5, le=360, description="Degrees per second that the robot turns at most")
    body_m: NotNegative = Field(default=0.4, le=10, description="Radius of the disc that stands for the robot's body")
    sensor_m: Positive = Field(default=4.0, le=100, description="How far the robot sees")
    prior: Literal["full", "coarse", "none"] = Field(
        default="coarse", description="What is known beforehand: all, a coarse map of the heights, or nothing"
    )
    coarse_m: Positive = Field(default=5.0, le=100, description="Blocks of the coarse map")

    def terrain(self, cell_m: float) -> Terrain:
        """The ground. Raises BadInput."""
        return _ground(self.model_dump_json(), cell_m)


@lru_cache(maxsize=4)
def _ground(section: str, cell_m: float) -> Terrain:
    """Made once: checks, world and drawing ask for it."""
    s = TerrainSection.model_validate_json(section)
    if s.heights is not None:
        return terrain_of(unpacked(s.heights), cell_m, slope_limit_deg=s.slope_limit_deg)
    return generate(
        s.generator,
        s.seed,
        size_m=(s.width_m, s.length_m),
        cell_m=cell_m,
        height_m=s.hills_m,
        count=s.hills,
        obstacles=s.obstacles,
        rough=s.rough,
        slope_limit_deg=s.slope_limit_deg,
        free=s.clear,
    )


class FloorSection(Section):
    kind: Literal["drawing", "blocks", "movingai", "network", "terrain"] = Field(
        default="drawing",
        description="Drawn in `rows`, generated from `blocks`, `rows` with MovingAI's letters, a network, or terrain",
    )
    rows: str | None = Field(default=None, description="The drawing, top row first, one letter per cell")
    map: str | None = Field(default=None, description="A file beside the scenario: MovingAI .map, or heights")
    blocks: BlocksSection | None = Field(default=None, description="Parameters of the generator `blocks`")
    network: NetworkSection | None = Field(default=None, description="Nodes and arcs of a network")
    terrain: TerrainSection | None = Field(default=None, description="Ground outdoors")
    cell_m: Positive = Field(default=1.0, le=100, description="Side of a cell in metres")
    connectivity: Literal[4, 8] = Field(default=4, description="Neighbours of a cell")
    occupancy: Literal["hold", "mapf"] = Field(default="hold", description="How vehicles exclude each other")
    margin_ticks: int = Field(default=0, ge=0, le=100, description="Ticks that a place stays closed after it was left")
    one_way: Literal["lanes", "ways"] = Field(
        default="lanes", description="ways: crossings too may be driven only in the directions of their lanes"
    )
    access: dict[str, Literal["south", "north", "west", "east"]] = Field(
        default_factory=dict, description="Side on which an endpoint is entered, by its name, such as R7"
    )

    def drawing(self) -> tuple[str, ...]:
        """Rows of letters, top row first; drawn or generated. Raises BadInput when the generator can't."""
        if self.kind == "blocks":
            return rows_of_blocks(**(self.blocks or BlocksSection()).model_dump())
        if self.kind == "terrain":
            obstacle = (self.terrain or TerrainSection()).terrain(self.cell_m).obstacle
            return tuple("".join("#" if shut else "." for shut in row) for row in obstacle[::-1].tolist())
        rows = tuple(line.strip() for line in (self.rows or "").splitlines() if line.strip())
        return tuple(row.translate(TERRAIN) for row in rows) if self.kind == "movingai" else rows


class MotionSection(Section):
    turning: Literal["arc", "pivot"] = Field(
        default="arc", description="Turn while driving into the next cell, or on the spot"
    )
    speed_mps: Positive = Field(default=1.0, le=50, description="Cruising speed in m/s, for energy")
    straight_ticks: Ticks = Field(default=1, description="Ticks of a step straight ahead")
    turn_ticks: Ticks = Field(default=1, description="Ticks of a turn")
    reverse_ticks: Ticks = Field(default=1, description="Ticks of a reversal")
    diagonal_ticks: Ticks = Field(default=1, description="Ticks of a diagonal step")


class ServiceSection(Section):
    pick_s: NotNegative = Field(default=5.0, description="Seconds to take a load")
    drop_s: NotNegative = Field(default=5.0, description="Seconds to hand a load over")


class FleetSection(Section):
    count: int = Field(ge=1, le=10_000, description="Vehicles")
    mass_kg: Positive = Field(default=1000.0, description="Mass of an empty vehicle")
    masses_kg: tuple[Positive, ...] = Field(
        default=(), max_length=127, description="Masses of the vehicles in turn, in place of mass_kg"
    )
    payload_kg: NotNegative = Field(default=0.0, description="Mass of a load")
    start: Literal["chargers", "parking"] | tuple[CellXY, ...] = Field(
        default="chargers",
        description="Where vehicles start: spread over the chargers or the parking, or cells [[x, y], …]",
    )
    heading: Literal["best", "east", "north", "west", "south"] = Field(
        default="best",
        description="Where they look at the start; `best` is along the cheapest way to the goal, else out of the bay",
    )

    @property
    def each_mass_kg(self) -> tuple[float, ...]:
        """Mass of every empty vehicle."""
        given = self.masses_kg or (self.mass_kg,)
        return tuple(given[v % len(given)] for v in range(self.count))


class EnergySection(Section):
    demand: str = Field(default="xu2025", min_length=1, description="Demand model, motion to joules")
    beside: str = Field(default="", description="A second demand model, computed as information only")
    parameters: dict[str, float] = Field(default_factory=dict, description="Parameters of the demand model")


class BatterySection(Section):
    model: str = Field(default="coulomb", min_length=1, description="Battery model, joules to state of charge")
    capacity_wh: Positive = Field(default=1000.0, description="Energy of a full battery")
    voltage_v: Positive = Field(default=48.0, description="Nominal voltage")
    exchange: Literal["off", "swap", "charge"] = Field(
        default="off",
        description="At entrances. swap: who loads or unloads there below charging.good gets a full battery. "
        "charge: on a network they are chargers, too",
    )
    initial_soc: SoC | tuple[SoC, SoC] = Field(
        default=1.0, description="State of charge at the start; [low, high] is drawn per vehicle from the seed"
    )
    parameters: dict[str, float] = Field(default_factory=dict, description="Parameters of the battery model")

    @field_validator("exchange", mode="before")
    @classmethod
    def _off(cls, value: object) -> object:
        return "off" if value == "none" else value  # the word in older runs

    @property
    def asked(self) -> dict[str, Any]:
        """What engine.energy.battery_of takes."""
        return {name: getattr(self, name) for name in ("model", "capacity_wh", "voltage_v", "parameters")}


class ChargerSection(Section):
    power_w: Positive = Field(default=1000.0, description="Power of a charger at the mains")
    rate_percent_per_s: Positive | None = Field(
        default=None, description="Percent of the battery per second, for `linear`"
    )
    efficiency: Share = Field(default=0.92, gt=0, description="Share of the charger's power that reaches the battery")


class ChargingSection(Section):
    policy: str = Field(default="levels", min_length=1, description="Charging policy")
    critical: Share = Field(default=0.15, description="Below it a vehicle charges before anything else")
    good: Share = Field(default=0.3, description="Below it a free vehicle goes charging")
    sufficient: Share = Field(default=0.8, description="From it a charging vehicle may take orders again")
    full: Share = Field(default=1.0, description="Where charging ends")
    reserve: Share = Field(default=0.05, description="Charge that no plan may use up")


class MixItem(Section):
    """A share of the Poisson orders: from any station of one kind to any of another."""

    from_: KindName = Field(validation_alias=AliasChoices("from", "from_"), serialization_alias="from")
    to: KindName
    weight: Positive = Field(default=1.0)


class OrdersSection(Section):
    source: Literal["listed", "poisson", "backlog", "goals"] = Field(
        default="poisson",
        description="Listed pairs, Poisson arrivals, an ever refilled backlog, or no orders: every vehicle has a goal",
    )
    goals: tuple[CellXY, ...] = Field(
        default=(), description="Cells [[x, y], …] where the vehicles go, one each, and stay"
    )
    pairs: tuple[tuple[StationNumber, StationNumber], ...] = Field(
        default=(), description="Orders as [from, to] station numbers, all known at the start"
    )
    rate_per_h: NotNegative = Field(default=60.0, description="Mean number of new orders per hour")
    mix: tuple[MixItem, ...] = Field(
        default=(
            MixItem(from_="inbound", to="rack", weight=1.0),
            MixItem(from_="rack", to="outbound", weight=1.0),
        ),
        min_length=1,
        description="Kinds of stations between which Poisson orders go, with weights",
    )
    initial: int = Field(default=0, ge=0, le=10_000, description="Poisson orders already waiting at the start")
    limit: int | None = Field(default=None, ge=0, description="Number of drawn orders; none is endless")
    backlog: int = Field(default=8, ge=1, le=10_000, description="Orders that a backlog keeps open")


class DispatchSection(Section):
    policy: str = Field(default="nearest", min_length=1, description="Who takes which order")
    exits: Literal["as ordered", "any outbound"] = Field(
        default="as ordered",
        description="any outbound: what is ordered to an outbound station may be brought to any; the dispatcher "
        "chooses",
    )
    regions: int = Field(
        default=0,
        ge=0,
        le=100,
        description="Strips of the floor from west to east; vehicle v takes orders from strip v, counted round; 0: "
        "none",
    )
    parameters: dict[str, int] = Field(default_factory=dict, description="Parameters of the dispatcher")


class PlannerSection(Section):
    name: str = Field(default="prioritized", min_length=1, description="Planner")
    objective: Literal["time", "energy", "distance"] = Field(default="time", description="What a plan minimises")
    parameters: dict[str, float | int | bool | str] = Field(
        default_factory=dict, description="Parameters of the planner"
    )
    work: int = Field(
        default=10_000_000, ge=1, le=10**12, description="Expansions that planning all vehicles at once may take"
    )


class FaultsSection(Section):
    delay_probability: Share = Field(default=0.0, description="Chance of a delay per started motion")
    delay_ticks: tuple[Ticks, Ticks] = Field(default=(1, 3), description="Shortest and longest delay")
    breakdowns_per_vehicle_day: NotNegative = Field(default=0.0, description="Mean number of breakdowns")
    repair_s: NotNegative = Field(default=600.0, description="Seconds until a broken vehicle works again")


class LogSection(Section):
    sample_s: Positive = Field(default=10.0, description="Seconds between battery samples")
    keyframe_s: Positive = Field(default=300.0, description="Seconds between keyframes")


class Scenario(Section):
    """Everything that determines a run, but for the commands given while it runs."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9._-]*$", max_length=80, description="Short name")
    title: str = Field(min_length=1, max_length=120, description="What a person reads in a list")
    description: str = Field(default="", description="What it shows and where it comes from")
    paper: str = Field(default="", description="Paper it follows, such as soochow2022")
    seed: int = Field(default=1, ge=0, le=2**63 - 1, description="Seed of everything that is drawn")
    time: TimeSection = Field(default_factory=TimeSection)
    floor: FloorSection
    motion: MotionSection = Field(default_factory=MotionSection)
    service: ServiceSection = Field(default_factory=ServiceSection)
    fleet: FleetSection
    energy: EnergySection = Field(default_factory=EnergySection)
    battery: BatterySection = Field(default_factory=BatterySection)
    charger: ChargerSection = Field(default_factory=ChargerSection)
    charging: ChargingSection = Field(default_factory=ChargingSection)
    orders: OrdersSection = Field(default_factory=OrdersSection)
    dispatch: DispatchSection = Field(default_factory=DispatchSection)
    planner: PlannerSection = Field(default_factory=PlannerSection)
    faults: FaultsSection = Field(default_factory=FaultsSection)
    log: LogSection = Field(default_factory=LogSection)

    def floor_plan(self) -> FloorPlan | NetworkPlan | TerrainPlan:
        """The floor as drawn or generated, for engine.world.build_world. Raises BadInput when it contradicts itself."""
        motion = self.motion
        if self.floor.kind == "terrain":
            return self.terrain_plan()
        if self.floor.kind == "network":
            nodes, arcs = (self.floor.network or NetworkSection()).parts()
            return NetworkPlan(
                nodes=nodes,
                arcs=arcs,
                mm_per_tick=motion.speed_mps * self.time.tick_s * 1000,
                turn_ticks=motion.turn_ticks,
                kerbs=(self.floor.network or NetworkSection()).kerbs,
                occupancy=Occupancy(self.floor.occupancy),
                margin_ticks=self.floor.margin_ticks,
                entrances_charge=self.battery.exchange == "charge",
            )
        return FloorPlan(
            rows=self.floor.drawing(),
            motion=GridMotion(
                cell_mm=round(self.floor.cell_m * 1000),
                turning=motion.turning,
                straight_ticks=motion.straight_ticks,
                turn_ticks=motion.turn_ticks,
                reverse_ticks=motion.reverse_ticks,
                diagonal_ticks=motion.diagonal_ticks,
            ),
            access=self.floor.access,
            connectivity=self.floor.connectivity,
            occupancy=Occupancy(self.floor.occupancy),
            margin_ticks=self.floor.margin_ticks,
            one_way=self.floor.one_way,
        )

    def terrain_plan(self) -> TerrainPlan:
        """The ground of a floor of kind `terrain`. Raises BadInput when it contradicts itself."""
        ground = self.floor.terrain or TerrainSection()
        return TerrainPlan(
            terrain=ground.terrain(self.floor.cell_m),
            tick_s=self.time.tick_s,
            speed_mps=self.motion.speed_mps,
            turn_rate=math.radians(ground.turn_rate_deg),
            cluster=ground.cluster,
            body_m=ground.body_m,
            sensor_m=ground.sensor_m,
            prior=ground.prior,
            coarse_m=ground.coarse_m,
        )

    def to_toml(self) -> str:
        """TOML text that parses to an equal scenario."""
        from engine.scenario.toml_text import write

        return write(self.model_dump(by_alias=True, exclude_none=True, exclude_defaults=False))
