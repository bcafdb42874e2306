"""What stands: one table of rules, which give a feature a kind, a reason why nothing stands, or unknown.

A rule holds for a feature by the values of a key (``KEY: VALUE VALUE ...``, in small letters; ``KEY of SHAPE: ...`` of
what has a shape alone: points, or what is lone), or by a sign of `signs.py` that has its name. Of all rules that hold
**the strongest decides, of equally strong ones that of the highest bound**, and of these the last of the table; its
name stays with what stands (`Footprints.rule`). **The bound is the highest of all that hold.** From the weakest:

- `ALONE`: what decides only where no other rule holds, as grounds and places do, and what is low by its name. What lies
  in a building of the file, but for a small one, names a place in it, and what holds some is the ground of them:
  neither is lone, if the buildings cover a tenth of an area, or half of a thing.
- `REASON`: a reason why nothing stands.
- `GROUNDS`: something of no kind, which stands only with a height of its own, as the grounds of a plant do.
- `UNSURE`: something of unknown kind or extent. Values are no sign of it where something is low or stands indoors, nor
  is the word yes of a pond, which says that this is historic or made.
- `HOUSES`: a building that another key than ``building`` names; without an area it is unknown.
- `SURE`: a structure of a known kind.
- `BUILDINGS`: a building, which the bound of what else it is bounds too.

Values are those of https://wiki.openstreetmap.org/wiki/Map_features. "*" is any value that no other row of its key has:
it is unknown with a bound, never nothing. Of a list of values (``a;b``) the one that decides so counts.
"""

from collections import defaultdict
from collections.abc import Mapping
from functools import reduce
from itertools import product
from typing import Literal

import numpy as np

from jaxurban.cities.kinds import (
    BRIDGE,
    CITY_WALL,
    FENCE,
    HISTORIC,
    HULL,
    IN_SPANS,
    LOW_LIMIT_M,
    LOW_M,
    MONUMENT,
    NOT_IN_USE,
    OF_LIFE,
    RIDE,
    STANDING,
    TURBINE,
    UNLISTED,
    WALL,
    WOOD,
    Kind,
    Nothing,
    unknown,
)
from jaxurban.cities.outlines import Outlines
from jaxurban.cities.signs import NO, ZERO, Signs, are_lone
from jaxurban.io.issues import ReadIssue
from jaxurban.io.learned import PACKAGED
from jaxurban.world.footprints import BUILDING, UNKNOWN

GROUND_SHARES = {
    "lone areas": 0.1,
    "lone things": 0.5,
    "lone points": 0.5,
}  # of buildings, in what is not lone
ALONE_ITSELF, REASON, GROUNDS, UNSURE, HOUSES, SURE = range(6)
LOW = Nothing(f"ends below {LOW_M:g} m")
GROUND = Nothing("is part of the ground, or level with it or with water")
FIXED = Nothing("is part of what stands, or fixed to it")
NO_THING = Nothing("names a place or a kind of building, and no thing")
BURIED = Nothing("lies below the ground", ReadIssue.UNDERGROUND)
SITE = Kind("structure", 0.0)  # the ground of a plant, or what only a height makes stand
LAMP = unknown(15.0, source="chosen; above all lamps in the extracts (10 m)")
CHIMNEY = Kind("chimney", 30.0, radius_m=3.0)
TOWER = Kind("tower", 30.0, radius_m=5.0)
MAST = Kind("mast", 20.0)
CRANE = Kind("crane", 30.0, radius_m=5.0)
SILO = Kind("tank", 20.0, radius_m=10.0)
POLE = Kind("pole", 10.0, 30.0, 0.5, "chosen; above all in the extracts (27 m)")
PYLON = Kind("pylon", 30.0, radius_m=3.0)
TREE = Kind(
    "tree", PACKAGED["tree"][0], 35.0, source="1,219 trees with heights: all end below 35 m"
)
POWER_LINE = Kind("wire", 30.0, 100.0, 15.0, IN_SPANS)
PHONE_LINE = Kind("wire", 10.0, 30.0, source=IN_SPANS)
CABLEWAY = Kind("cableway", 30.0, radius_m=5.0)
GANTRY = Kind("canopy", 6.0, 20.0)
SHED = unknown(LOW_LIMIT_M, source="as of houses and sheds")
SLENDER = unknown(30.0, 2.0)
LARGE = unknown(150.0, 5.0, "chosen; Wembley's arch ends at 133 m, Jeddah Light as well")
Gives = Kind | Nothing | Literal["building"]
OF_AREAS = " of lone areas: "  # of names of rules
# Columns that name kinds by our own words; some words say as well what sort a building is, and are none of these.
OWN_KEYS = ("kind", "class", "type")
OURS = (CHIMNEY, TOWER, MAST, CRANE, SILO, POLE, PYLON, TURBINE, TREE, WOOD, POWER_LINE, CABLEWAY)
ALONE: dict[str, Gives] = {
    "nothing of the table": Nothing("names nothing that stands", ReadIssue.NOT_BUILDINGS),
    # Grounds, on which what stands has outlines of its own.
    "amenity: school university college kindergarten hospital parking parking_space motorcycle_parking grave_yard "
    "marketplace research_institute prep_school bus_station taxi car_sharing car_rental bicycle_rental boat_rental "
    "waste_transfer_station dog_toilet animal_training biergarten": GROUND,
    "parking: surface street_side on_street lane on_kerb half_on_kerb shoulder layby inline diagonal perpendicular "
    "yes no": GROUND,
    "leisure: pitch park playground garden common schoolyard track sports_centre recreation_ground nature_reserve "
    "dog_park golf_course miniature_golf disc_golf_course swimming_pool swimming_area bathing_place beach_resort "
    "resort marina slipway horse_riding fishing fitness_station outdoor_seating village_green wildlife_reserve "
    "summer_camp paddling_pool": GROUND,
    "tourism: attraction theme_park zoo viewpoint camp_site caravan_site camp_pitch picnic_site yes": GROUND,
    "aeroway: aerodrome heliport helipad apron runway taxiway taxilane stopway holding_position parking_position "
    "aircraft_crossing airstrip spaceport landingpad highway_strip": GROUND,
    "railway: platform platform_edge turntable traverser yard site junction "
    "level_crossing crossing railway_crossing switch": GROUND,
    "public_transport: platform": GROUND,
    "military: airfield base naval_base training_area danger_area range trench exclusion_zone obstacle_course": GROUND,
    "emergency: landing_site assembly_point fire_water_pond water_rescue_station": GROUND,
    "seamark:type: berth harbour anchorage fairway dredged_area restricted_area shoreline_construction gate": GROUND,
    # Places, which are buildings or lie in them.
    "amenity: place_of_worship restaurant cafe fast_food bar pub ice_cream food_court bank pharmacy clinic dentist "
    "doctors veterinary theatre cinema library townhall courthouse fire_station police post_office community_centre "
    "arts_centre nightclub social_facility childcare embassy events_venue studio parking_entrance atm "
    "ferry_terminal": NO_THING,
    "tourism: hotel hostel guest_house museum gallery information apartment": NO_THING,
    "public_transport: station stop_position stop_area stop_area_group": NO_THING,
    "railway: station halt stop tram_stop facility": NO_THING,
    "aeroway: gate": NO_THING,
    # Low things.
    "amenity: bench bicycle_parking bicycle_repair_station waste_basket waste_disposal recycling vending_machine "
    "post_box drinking_water water_point watering_place telephone clock bbq shelter lounger charging_station "
    "parcel_locker public_bookcase payment_terminal loading_dock life_ring feeding_place table fountain": LOW,
    "leisure: picnic_table firepit": LOW,
    "railway: subway_entrance buffer_stop milestone derail": LOW,
    "advertising: poster_box board": LOW,
    "memorial: plaque blue_plaque stolperstein grave ghost_bike bust stone bench tree urn tablet": LOW,
    "artwork_type: bust stone dwarf fountain land_art": LOW,
    "emergency: fire_hydrant phone fire_alarm_box fire_extinguisher fire_hose defibrillator life_ring lifebuoy "
    "suction_point water_tank first_aid_kit": LOW,
    "waterway: weir": LOW,
    "seamark:type: mooring notice buoy_lateral buoy_cardinal buoy_special_purpose buoy_isolated_danger "
    "buoy_safe_water": LOW,
    "advertising: wall_painting": FIXED,
    "artwork_type: mural painting relief mosaic graffiti frieze streetart tilework azulejo stained_glass": FIXED,
    "parking: underground": BURIED,
    "area in a file that names no buildings": BUILDING,
    "height in words": UNLISTED,
}
THINGS: dict[str, Gives] = {
    "height below 6 m": LOW,
    "form of the land, or a waterfall": GROUND,
    "razed": Nothing("does not stand any more", ReadIssue.RAZED),
    "planned": Nothing("does not stand yet", ReadIssue.PLANNED),
    "traffic above the ground": FIXED,
    "height of 6 m or more": SITE,
    "height beyond 1,000 m, or that cannot be read": unknown(),
    "generator of unknown source and height": unknown(radius_m=50.0),  # of wind, perhaps
    "barrier of 6 m or more": FENCE,
    "way of traffic above the ground": BRIDGE,
    "wind turbine": TURBINE,
    # Keys of which other values name no obstacles.
    "natural: tree tree_row": TREE,
    "natural: wood": WOOD,
    "natural: scrub shrub rock stone": LOW,
    "natural: cliff": unknown(50.0),
    "landuse: forest": WOOD,
    "highway: street_lamp": LAMP,
    "lamp_mount: high_mast": UNLISTED,
    "highway: gantry toll_gantry": GANTRY,
    "highway of points: gantry toll_gantry": Kind("canopy", 6.0, 20.0, 15.0),  # from side to side
    "highway of lone things: elevator": SHED,
    "railway: signal_bridge gantry": GANTRY,
    "railway: signal": LAMP,
    "railway: water_tower": TOWER,
    "railway: monorail": BRIDGE,
    "railway: coaling_facility": UNLISTED,
    "railway of lone things: ventilation_shaft crossing_box": SHED,
    "railway: loading_tower loading_rack loading_gauge": UNLISTED,
    "highway of lone things: toll_booth": SHED,
    "power of lone areas: substation sub_station station transformer": SLENDER,  # gantries
    "viaduct: yes": BRIDGE,
    "waterway: dam": unknown(350.0, 5.0, "chosen; Jinping-I is 305 m high"),
    "waterway: lock_gate sluice_gate": SLENDER,
    "waterway: boat_lift": LARGE,
    "aeroway: windsock": POLE,
    "aeroway: control_tower tower": TOWER,
    "aeroway: jet_bridge": GANTRY,
    "aeroway: navigationaid": UNLISTED,
    "aeroway: balloon launchpad": LARGE,
    "seamark:type: light_major light_vessel light_float": LARGE,
    "seamark:type: light light_minor pile beacon_lateral beacon_cardinal beacon_isolated_danger beacon_safe_water "
    "beacon_special_purpose buoy_installation": SLENDER,
    "seamark:type: landmark": unknown(),  # a chimney, a mast or a tower as well
    "seamark:type: platform": TOWER,
    "seamark:type: pylon": PYLON,
    "seamark:type: radar_station radar_transponder building fortified_structure signal_station_traffic "
    "signal_station_warning coastguard_station rescue_station": UNLISTED,
    "seamark:type: crane": CRANE,
    "seamark:type: cable_overhead": POWER_LINE,
    "seamark:type: pipeline_overhead conveyor": UNLISTED,
    "advertising: billboard totem sign screen flag sculpture tarp": UNLISTED,
    "advertising: column": LAMP,
    "memorial: statue obelisk column tower arch monument cenotaph mausoleum pyramid bell_tower": MONUMENT,
    "memorial: war_memorial sculpture stele cross pavilion aircraft vehicle ship building chapel gate wall lantern "
    "prow flagpole anchor crucifix torii lych_gate": SLENDER,
    "artwork of unknown type": UNLISTED,
    "artwork_type: *": UNLISTED,
    "artwork_type: statue obelisk column tower arch monument": MONUMENT,
    "artwork_type: sculpture installation architecture totem totem_pole windmill": SLENDER,
    "tourism: artwork": FIXED,  # where its type says so, as of a mural
    "emergency: siren": SLENDER,
    "emergency: lifeguard_tower": LAMP,
    "amenity: hunting_stand": LAMP,
    # Buildings that another key names.
    "levels of a building": BUILDING,
    "parking of lone things: multi-storey rooftop": BUILDING,
    "parking of lone things: sheds carports garage garages garage_boxes": SHED,
    "aeroway of lone things: hangar terminal": BUILDING,
    "railway of lone things: engine_shed roundhouse signal_box workshop": BUILDING,
    "leisure of lone things: sports_hall": BUILDING,
    "leisure of lone things: stadium grandstand arena": LARGE,
    "piste:type: ski_jump": LARGE,
    "communication:mobile_phone of lone points: yes": unknown(100.0, 5.0),
    "leisure of lone points: stadium arena": unknown(LARGE.limit_m, 100.0, LARGE.source),
    "leisure of lone things: water_park water_slide high_ropes_course adventure_park": UNLISTED,
    "leisure of lone things: bleachers bandstand bird_hide wildlife_hide": SHED,
    "military of lone things: barracks bunker checkpoint": HULL,
    "amenity of lone areas: place_of_worship monastery crematorium mortuary funeral_hall theatre cinema library "
    "toy_library townhall courthouse public_building fire_station police prison embassy post_office post_depot "
    "community_centre arts_centre conference_centre exhibition_centre events_venue concert_hall music_venue "
    "planetarium studio casino gambling nightclub stripclub brothel swingerclub love_hotel bank bureau_de_change "
    "pharmacy clinic doctors dentist veterinary nursing_home social_facility social_centre childcare restaurant cafe "
    "fast_food bar pub food_court ice_cream internet_cafe coworking_space public_bath dojo driving_school "
    "language_school music_school dancing_school vehicle_inspection ferry_terminal animal_boarding animal_shelter "
    "animal_breeding ranger_station hookah_lounge retirement_home convention_centre dormitory register_office": HULL,
    "healthcare of lone areas: hospital clinic doctor dentist centre laboratory pharmacy alternative audiologist "
    "birthing_centre blood_bank blood_donation counselling dialysis hospice midwife nurse nutrition_counselling "
    "occupational_therapist optometrist physiotherapist podiatrist psychotherapist rehabilitation sample_collection "
    "speech_therapist vaccination_centre yes": HULL,
    "craft of lone areas: brewery carpenter sawmill winery distillery agricultural_engines atelier bakery basket_maker "
    "beekeeper blacksmith boatbuilder bookbinder builder cabinet_maker car_painter carpet_layer caterer "
    "chimney_sweeper cleaning clockmaker confectionery cooper cosmetics dental_technician door_construction dressmaker "
    "electrician electronics electronics_repair embroiderer engraver fence_maker floorer gardener glassblower glaziery "
    "goldsmith grinding_mill handicraft hvac insulation interior_work jeweller joiner key_cutter laboratory leather "
    "locksmith luthier metal_construction metal_works mint musical_instrument oil_mill optician organ_builder painter "
    "parquet_layer paver photographer photographic_laboratory piano_tuner plasterer plumber pottery print_shop printer "
    "printmaker rigger roofer saddler sailmaker scaffolder sculptor shoemaker signmaker stand_builder stonemason "
    "stove_fitter sun_protection tailor tiler tinsmith toolmaker turner upholsterer watchmaker weaver welder "
    "window_construction yes": HULL,
    "club of lone areas: scout sport social youth veterans music art automobile culture freemasonry game history "
    "linux motorcycle nature sailing shooting student theatre yes": HULL,
    "amenity of lone areas: fuel car_wash toilets shower kiosk stage dressing_room compressed_air boat_storage "
    "sanitary_dump_station": SHED,
    "leisure of lone areas: fitness_centre dance bowling_alley ice_rink amusement_arcade adult_gaming_centre "
    "escape_game hackerspace indoor_play trampoline_park tanning_salon sauna social_club spa": HULL,
    "tourism of lone areas: hotel motel hostel guest_house apartment apartments chalet alpine_hut wilderness_hut "
    "museum gallery aquarium": HULL,
    "shop of lone areas: mall department_store supermarket convenience wholesale tiles tailor farm truck "
    "musical_instrument hifi chocolate general variety_store clothes shoes "
    "jewelry optician books stationery electronics computer mobile_phone furniture kitchen interior_decoration "
    "doityourself hardware trade paint garden_centre florist agrarian car car_repair car_parts caravan boat motorcycle "
    "tyres bicycle sports outdoor toys gift art antiques second_hand charity bakery butcher deli beverages alcohol "
    "greengrocer seafood confectionery pastry chemist beauty hairdresser cosmetics massage laundry dry_cleaning kiosk "
    "newsagent tobacco ticket travel_agency funeral_directors pet copyshop rental storage_rental houseware fabric "
    "wine coffee tea tattoo cannabis bed bag music camera video video_games games photo photo_studio frame model anime "
    "e-cigarette nutrition_supplements health_food dairy cheese pasta spices frozen_food water ice_cream nuts rice "
    "brewing_supplies perfumery hairdresser_supply hearing_aids herbalist medical_supply piercing baby_goods boutique "
    "fashion fashion_accessories leather sewing shoe_repair watches wool curtain carpet flooring doors windows "
    "glaziery fireplace gas groundskeeping locksmith security swimming_pool bathroom_furnishing household_linen "
    "candles craft collector trophy party pawnbroker outpost pyrotechnics religion weapons hunting fishing golf ski "
    "surf scuba_diving horse_riding equestrian pet_grooming bookmaker lottery money_lender appliance electrical "
    "energy lighting tool_hire atv snowmobile fuel motorcycle_repair truck_repair trailer radiotechnics "
    "telecommunication vacuum_cleaner hobby tableware fishmonger market duty_free country_store military_surplus "
    "plant_hire pottery mobile_home boat_repair bus estate_agent insurance internet_cafe spare_parts cash_and_carry "
    "vacant yes": HULL,
    "office of lone areas: company government administrative diplomatic tax_advisor logistics ngo association "
    "insurance financial lawyer estate_agent it coworking research "
    "accountant advertising_agency architect airline attorney bail_bond_agent broadcaster chamber consulting courier "
    "construction_company design educational engineer event_management employment_agency financial_advisor forestry "
    "foundation geodesist graphic_design guide harbour_master healthcare internet_service_provider moving_company "
    "newspaper notary parish physician political_party politician property_management publisher quango security "
    "surveyor tax therapist trade_union translator transport travel_agent union university visa water_utility website "
    "coworking_space private_investigator adoption_agency real_estate camping club "
    "educational_institution telecommunication energy_supplier religion yes": HULL,
    "public_transport of lone areas: station": HULL,
    "railway of lone areas: station halt": HULL,
    "emergency of lone areas: ambulance_station mountain_rescue fire_station lifeguard control_centre": HULL,
    "location of ways: overhead": unknown(30.0, 2.0),
    "location of ways: overground": unknown(50.0),
    "location of points: overhead overground": LAMP,
    **{f"{key}: {kind.name}": kind for key, kind in product(OWN_KEYS, OURS)},
    # Keys of which any value names what may stand.
    "tower:type: *": TOWER,
    "man_made: chimney stack flare": CHIMNEY,
    "man_made: tower communications_tower water_tower lighthouse obelisk bell_tower clock_tower watchtower "
    "minaret campanile headframe ski_jump offshore_platform cooling_tower": TOWER,
    "man_made: windmill telescope radar": Kind("tower", 20.0, radius_m=10.0),
    "man_made: mast antenna beacon": MAST,
    "man_made: crane": CRANE,
    "man_made: tank storage_tank": Kind(
        "tank", 10.0, 30.0, 8.0, "shells by API 650 seldom exceed 64 ft"
    ),
    "man_made: silo gasometer": SILO,
    "man_made: flagpole utility_pole pole": POLE,
    "man_made: canopy gantry goods_conveyor": GANTRY,
    "man_made: beam": Kind("canopy", 6.0, 15.0),  # of signs and signals over streets
    "man_made: bridge": BRIDGE,
    "man_made: works wastewater_plant water_works spoil_heap": SITE,
    "man_made: pier breakwater groyne dyke embankment cutline cutting quay courtyard excavation reservoir_covered "
    "clearcut compass_rose": GROUND,
    "man_made: survey_point water_tap drinking_fountain street_cabinet planter water_well bunker_silo "
    "carpet_hanger insect_hotel cairn": LOW,
    "man_made: surveillance": FIXED,
    "man_made: tunnel cable manhole adit": BURIED,
    "man_made: wire": PHONE_LINE,
    "man_made: *": UNLISTED,
    "power: tower": Kind(
        "pylon", 30.0, 100.0, 4.0, "chosen; higher ones carry wires across water (the Elbe: 227 m)"
    ),
    "power: pole portal catenary_mast": POLE,
    "power: generator plant substation sub_station station transformer": SITE,
    "power: cable": BURIED,
    "power: box cable_distribution_cabinet": LOW,
    "power: terminal insulator switch connection": FIXED,
    "power: line": POWER_LINE,
    "power: minor_line": Kind("wire", 10.0, 30.0, 2.0, IN_SPANS),
    "power: *": UNLISTED,
    "aerialway: pylon": PYLON,
    "aerialway: station": Kind("structure", 10.0, 30.0, 10.0),
    "aerialway: cable_car gondola chair_lift mixed_lift goods zip_line": CABLEWAY,
    "aerialway: drag_lift t-bar j-bar platter rope_tow": Kind(
        "cableway", 10.0, 30.0, 3.0, IN_SPANS
    ),
    "aerialway: magic_carpet": GROUND,
    "aerialway: *": UNLISTED,
    "bridge: *": BRIDGE,
    "bridge:support: *": unknown(350.0, 5.0, "chosen; Millau has one of 343 m"),
    "attraction: animal artwork bumper_car bumper_cars garden kiddie_ride maze petting_zoo playground train": LOW,
    "attraction: *": RIDE,
    "roller_coaster: *": RIDE,
    "historic: memorial plaque blue_plaque stone boundary_stone milestone cross wayside_cross wayside_shrine "
    "stolperstein grave": LOW,
    "historic: district neighbourhood archaeological_site battlefield": NO_THING,
    "historic: monument tower gate city_gate column obelisk lighthouse": MONUMENT,
    "historic: citywalls city_wall castle_wall": CITY_WALL,
    "historic: *": HISTORIC,
    "barrier: kerb fence hedge bollard gate block lift_gate chain guard_rail jersey_barrier wedge rope turnstile "
    "full-height_turnstile swing_gate sliding_gate kissing_gate wicket_gate hampshire_gate cycle_barrier "
    "motorcycle_barrier horse_stile stile step sally_port spikes handrail railing height_restrictor log debris "
    "cable_barrier planter rock bus_trap sump_buster tank_trap delineators bar yes_gate wire_fence": LOW,
    "barrier: ditch cattle_grid": GROUND,
    "barrier: entrance door": FIXED,
    "barrier: wall retaining_wall": WALL,
    "barrier: city_wall": CITY_WALL,
    "barrier: *": UNLISTED,
    "telecom: line": PHONE_LINE,
    "telecom: exchange data_center data_centre central_office": NO_THING,
    "telecom: service_device connection_point distribution_point remote_terminal street_cabinet": LOW,
    "telecom: *": UNLISTED,
    "communication: line": PHONE_LINE,
    "communication: *": UNLISTED,
    "pipeline: marker valve": LOW,
    "pipeline: *": UNLISTED,
}
BUILDINGS: dict[str, Gives] = {
    "deck of a bridge": BUILDING,
    "building": BUILDING,
    "building without an area": HULL,
}
# What else than by their value is called that is of unknown kind.
LABELS = {
    "height in words": "height",
    "generator of unknown source and height": "power=generator",
}


def _strength(name: str) -> int:
    """Return how much a rule counts beside others."""
    if name in ALONE:
        return ALONE_ITSELF
    gives = THINGS[name]
    if isinstance(gives, Nothing):
        return REASON
    if gives == BUILDING:
        return HOUSES
    if gives is SITE:
        return GROUNDS
    return UNSURE if gives.name == UNKNOWN else SURE


def _weight(name: str) -> tuple[int, float]:
    """Return what rules are ordered by: their strength, then their bound."""
    return _strength(name), getattr(THINGS.get(name), "limit_m", 0.0)


RULES = ALONE | {name: THINGS[name] for name in sorted(THINGS, key=_weight)} | BUILDINGS
RANKS = {name: np.int16(rank) for rank, name in enumerate(RULES)}
NO_RULE = RANKS["nothing of the table"]
NAMES = np.array([*RULES], object)
GIVES = np.array([*RULES.values()], object)
LIMITS_M = np.array([getattr(gives, "limit_m", 0.0) for gives in GIVES])
LAST_WITHOUT_BOUND = max(RANKS[name] for name in THINGS if _strength(name) <= GROUNDS)
FIRST_OF = np.array(
    [[*RULES.values()].index(gives) for gives in RULES.values()]
)  # of those that give the same
BOUNDS_OTHERS = np.array(  # what stands without a height of its own
    [isinstance(gives, Kind) and (gives.height_m > 0 or gives.name == UNKNOWN) for gives in GIVES]
)
IS_UNSURE = np.array([name in THINGS and _strength(name) == UNSURE for name in RULES])
VALUES: dict[str, dict[str, str]] = {}  # the rules by key, with the shape, and by value
OF_KEYS: dict[str, dict[str, str]] = {}  # the strongest of all shapes, by key and value
for name in RULES:
    key, _, values = name.partition(": ")
    for value in values.split():
        VALUES.setdefault(key, {})[value] = name
        OF_KEYS.setdefault(key.partition(" of ")[0], {})[value] = name
KINDS = {key: rules for key, rules in VALUES.items() if "*" in rules}
IN_WORDS = {key: VALUES[key] for key in OWN_KEYS}
BY_VALUE = {key: rules for key, rules in OF_KEYS.items() if key not in KINDS | IN_WORDS}
OF_USE = (  # keys by value of what may be out of use, and stands
    *("aeroway", "amenity", "leisure", "military", "office", "railway", "shop", "tourism"),
)
# What comes before keys of what is not in use, or not yet, and stands.
LIVES: dict[str, tuple[str, ...]] = dict.fromkeys(("building", *KINDS, *OF_USE), NOT_IN_USE)
LIVES |= dict.fromkeys(OF_LIFE, STANDING)


def decide(outlines: Outlines, signs: Signs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rule that decides on each of ``N`` features, and what it is beside a building.

    Args:
      outlines: the features.
      signs: of these.

    Returns:
      Two indices of `RULES`, ``[N]`` each: of the rule that decides, and of the one that decides beside a building; and
      the highest bound of the rules that give another kind, in metres, 0 without one.
    """
    held = [RANKS[name] * signs[name] for name in signs.keys() & (ALONE | THINGS)]
    held += _held_by_values(outlines, signs)
    beside = reduce(np.maximum, held)
    decided = reduce(np.maximum, [RANKS[name] * signs[name] for name in BUILDINGS], beside)
    limits_m = _limits_of_others_m(held, beside, decided == beside)
    is_thin = (GIVES[decided] == BUILDING) & ~signs["areas"]
    return np.where(is_thin, RANKS["building without an area"], decided), beside, limits_m


def _held_by_values(outlines: Outlines, signs: Signs) -> list[np.ndarray]:
    """Return the rules that the values of each key name, as of `_by_value`, 0 where the shape is none of the key's.

    Args:
      outlines, signs: as of `decide`.
    """
    of_shapes: defaultdict[str, list[np.ndarray]] = defaultdict(list)
    for key, rules in VALUES.items():
        tag, _, shape = key.partition(" of ")
        if tag in outlines.tags:
            of_shapes[shape].append(_by_value(*outlines.words(tag), signs, rules))
    held = []
    for shape, of_keys in of_shapes.items():
        is_it = np.ones(len(outlines.polygons), bool) & signs.get(shape, True)
        if shape.startswith("lone"):
            is_asked = is_it & (reduce(np.maximum, of_keys) > 0)
            share = GROUND_SHARES[shape]
            is_it = are_lone(outlines, signs["building"] & ~signs["below"], is_asked, share)
        held += [ranks * is_it for ranks in of_keys]
    return held


def _limits_of_others_m(
    held: list[np.ndarray], beside: np.ndarray, is_itself: np.ndarray
) -> np.ndarray:
    """Return ``[N]`` the highest bound of the rules that give another kind than the one that decides, 0 without one.

    Args:
      held: ``[N]`` rules each, 0 where they do not hold.
      beside: ``[N]`` the rules that decide beside a building.
      is_itself: ``[N]`` bool, where there is no building and these decide.
    """
    limits_m = np.where(is_itself, 0.0, LIMITS_M[beside])
    for ranks in held:
        rows = np.flatnonzero(ranks > LAST_WITHOUT_BOUND)
        others = ranks[rows]
        is_own = is_itself[rows] & (FIRST_OF[others] == FIRST_OF[beside[rows]])
        of_others_m = np.where(BOUNDS_OTHERS[others] & ~is_own, LIMITS_M[others], 0.0)
        limits_m[rows] = np.maximum(limits_m[rows], of_others_m)
    return limits_m


def _by_value(
    number: np.ndarray, values: np.ndarray, signs: Signs, rules: Mapping[str, str]
) -> np.ndarray:
    """Return ``[N]`` the rules that the values of a tag name, as indices of `RULES`, `NO_RULE` where they name none.

    What is low or indoors is not taken for something unknown, and neither is a pond by ``man_made=yes`` or the like.

    Args:
      number: ``[N]`` which value each feature has.
      values: the different values.
      signs: as of `decide`.
      rules: by value.
    """
    strongest = [RANKS[_strongest(value, rules, signs["names"])] for value in values]
    ranks = np.array(strongest, np.int16)[number]
    is_yes_of_pond = signs["pond"] & (values == "yes")[number]
    is_dismissed = (signs["low"] | is_yes_of_pond) & IS_UNSURE[ranks]
    return np.where(is_dismissed, NO_RULE, ranks)


def _strongest(text: str, rules: Mapping[str, str], has_numbers: bool) -> str:
    """Return the rule by a value, or the one of a list with semicolons that decides; the first of all without one.

    Args:
      text: the value in small letters.
      rules: by value.
      has_numbers: whether a number but 0 names something as well.
    """
    words = [word.strip() for word in text.split(";")]
    words = [word for word in words if word not in (*NO, *ZERO)]
    other = rules.get("*")
    named = [rules.get(word, other) for word in words if has_numbers or word[0].isalpha()]
    return max(filter(None, named), key=_weight, default=NAMES[0])


def labels_of(outlines: Outlines, ranks: np.ndarray) -> np.ndarray:
    """Return ``[N]`` what the file calls what is unknown by the rules that decide, ``""`` of all else."""
    labels = np.full(len(ranks), "", object)
    for rank in np.unique(ranks):
        if getattr(GIVES[rank], "name", "") == UNKNOWN:
            name = NAMES[rank]
            tag = name.partition(": ")[0].partition(" of ")[0]
            is_it = ranks == rank
            labels[is_it] = LABELS.get(name, "")
            if tag in outlines.tags:
                labels[is_it] = f"{tag}=" + outlines.texts(tag)[is_it]
    return labels
