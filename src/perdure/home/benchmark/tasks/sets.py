"""Sets of objects and receptacles that the tasks share (M3, `scripts/datasets/configs/*_220417.yaml`)."""

PANTRY = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "024_bowl",
)
"""The nine objects of TidyHouse, PrepareGroceries and all clutter."""

CHAIR = "receptacle_aabb_Chr1_Top1_frl_apartment_chair_01"
TABLE_1 = "receptacle_aabb_Tbl1_Top1_frl_apartment_table_01"
TABLE_2 = "receptacle_aabb_Tbl2_Top1_frl_apartment_table_02"
TV_STAND = "receptacle_aabb_TvStnd1_Top1_frl_apartment_tvstand"
COUNTER_RIGHT = "receptacle_aabb_counter_right_kitchen_counter"
COUNTER_LEFT = "receptacle_aabb_counter_left_kitchen_counter"
SOFA = "receptacle_aabb_Sofa_frl_apartment_sofa"
FRIDGE_MIDDLE = "receptacle_aabb_middle_topfrl_apartment_refrigerator"
FRIDGE_TOP = "receptacle_aabb_topfrl_apartment_refrigerator"
DRAWERS = (
    "receptacle_aabb_drawer_left_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_middle_top_frl_apartment_kitchen_counter",
    "receptacle_aabb_drawer_right_top_frl_apartment_kitchen_counter",
)

OPEN_SURFACES = (CHAIR, TABLE_1, TABLE_2, TV_STAND, COUNTER_RIGHT, COUNTER_LEFT, SOFA)
"""M3 leaves the sink out, which the original benchmark had."""
CLUTTERED = (*OPEN_SURFACES, FRIDGE_TOP)
MIDDLE_HALF = {FRIDGE_MIDDLE: 0.5}
"""Targets stand in the middle half of the middle shelf's length and width."""
