# SPDX-License-Identifier: Apache-2.0
"""Services of a node that runs `SlamStage`: save the map, and load one to start in.

~/save_map    std_srvs/Trigger: all landmarks mapped until the last epoch, into the file of the parameter map_file
~/load_map    std_srvs/Trigger: the map of that file, for a vehicle that waits to start in one (start.method map)

Neither takes a map without landmarks, and a map that was loaded is not written over. Whatever goes wrong is in the
response, and the node goes on. So it does while a map is saved: the covariances of half an hour's map take a minute or
two to bound.
"""

import threading
from collections.abc import Awaitable, Callable, Generator
from concurrent.futures import Future

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from uav_vslam.config import expanded
from uav_vslam.errors import MapError
from uav_vslam.slam.saved_map import Mapped, SavedMap, load_map, save_map
from uav_vslam.slam.stage import SlamStage


def offer_map_services(node: Node, stage: Callable[[], SlamStage]) -> None:
    """Create both services on a node that has declared map_file; `stage` returns the current one."""

    async def save() -> str:
        job, path = Future[str](), _map_file(node)
        args = job, stage().mapped(), path, stage().loaded_map
        threading.Thread(target=_save, args=args, daemon=True).start()
        while not job.done():
            await _NextTurn()
        return job.result()

    async def load() -> str:
        path = _map_file(node)
        saved = load_map(path)
        stage().load_map(saved)
        return f"{path}: map {saved.hash} of {saved.origin.vehicle}, {len(saved)} landmarks"

    node.create_service(Trigger, "~/save_map", _answering(save), callback_group=MutuallyExclusiveCallbackGroup())
    node.create_service(Trigger, "~/load_map", _answering(load))


class _NextTurn:
    """Awaited by a callback that lets the executor turn to others."""

    def __await__(self) -> Generator[None]:
        yield


def _save(job: Future[str], mapped: Mapped, path: str, loaded: SavedMap | None) -> None:
    """Save a map; the job's result is the service's answer."""
    try:
        if loaded is not None and _hash_of(path) == loaded.hash:
            raise MapError(f"{path} is the map that was loaded, which a save would replace; give map_file another name")
        saved = mapped.saved_map()
        if not len(saved):
            raise MapError(f"no landmark is mapped so far, and {path} is not written; save in flight, before a reset")
        size = save_map(saved, path)
        job.set_result(f"{path}: map {saved.hash}, {len(saved)} landmarks in {size / 1e3:.0f} kB")
    except Exception as error:  # of whatever kind, it is raised where the job is waited for
        job.set_exception(error)


def _hash_of(path: str) -> str | None:
    """Return the hash of the map in a file; None if there is no map."""
    try:
        return load_map(path).hash
    except MapError:
        return None


def _map_file(node: Node) -> str:
    name: str = node.get_parameter("map_file").value
    if not name:
        raise MapError("the parameter map_file is empty; set it to the name of a file")
    return str(expanded(name, "map_file").absolute())


def _answering(
    action: Callable[[], Awaitable[str]],
) -> Callable[[Trigger.Request, Trigger.Response], Awaitable[Trigger.Response]]:
    async def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = await action(), True
        except Exception as error:  # of whatever kind: in flight, a map is not worth the node
            response.message, response.success = str(error) or type(error).__name__, False
        return response

    return call
