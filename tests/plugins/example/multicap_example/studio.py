"""Calibrations of a studio: a line a camera with its name, focal length, size of the picture and place in metres."""

from multicap import CalibrationReading, CameraFile, RawCamera, calibration_reader


@calibration_reader("Studio", suffixes=(".studio",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the cameras, which look along the world's z axis."""
    raw = []
    for line in content.decode().splitlines():
        name, *words = line.split()
        focal_px, width, height, *place_m = map(float, words)
        matrix = [[focal_px, 0.0, width / 2], [0.0, focal_px, height / 2], [0.0, 0.0, 1.0]]
        rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        raw.append(RawCamera(name, [width, height], matrix, [], rotation, [-length_m for length_m in place_m]))
    return CalibrationReading(file).contents("Studio", raw, "m")
