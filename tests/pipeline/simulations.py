"""Files of simulated captures."""

from pathlib import Path

from pipeline.validation.simulation.scenes import Simulation, simulation_files


def write_simulation(simulation: Simulation, folder: Path) -> None:
    """Write the files of a simulation to a folder."""
    for name, content in simulation_files(simulation):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
