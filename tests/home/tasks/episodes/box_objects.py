"""Objects of the benchmark's sizes and masses as plain boxes and cylinders, for tests of the generator."""

SIZES = {  # full sizes in meters, mass in kilograms
    "002_master_chef_can": (0.102, 0.102, 0.140, 0.414),
    "003_cracker_box": (0.072, 0.164, 0.213, 0.411),
    "004_sugar_box": (0.050, 0.094, 0.176, 0.514),
    "005_tomato_soup_can": (0.068, 0.068, 0.102, 0.349),
    "007_tuna_fish_can": (0.086, 0.086, 0.034, 0.171),
    "008_pudding_box": (0.110, 0.089, 0.035, 0.187),
    "009_gelatin_box": (0.085, 0.073, 0.028, 0.097),
    "010_potted_meat_can": (0.102, 0.060, 0.084, 0.370),
    "024_bowl": (0.161, 0.161, 0.055, 0.147),
    "013_apple": (0.075, 0.075, 0.075, 0.068),
}


class BoxObjects:
    """Every object is its bounding box."""

    def box(self, kind):
        x, y, z, _ = SIZES[kind]
        return (-x / 2, -y / 2, -z / 2), (x / 2, y / 2, z / 2)

    def add(self, spec, kind, name, position, quaternion):
        import mujoco

        x, y, z, mass = SIZES[kind]
        body = spec.worldbody.add_body(name=name, pos=position, quat=quaternion)
        body.add_freejoint()
        size = (x / 2, y / 2, z / 2)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, mass=mass, friction=(0.5, 0.005, 1e-4))
