import numpy as np

from perdure.home.sim.apartments import build_apartment, cut_away, make_apartment


def test_cut_away_hides_the_walls_in_front_of_the_camera_only():
    apartment = make_apartment(0, 0)  # walls 0 to 3: south, east, north, west
    model = build_apartment(apartment).compile()
    cut_away(model, apartment, np.array([4.2, -6.0, 5.0]))
    alpha = [float(model.geom(f"wall_{k}/slab").rgba[3]) for k in range(4)]
    assert alpha == [0.0, 1.0, 1.0, 1.0]
