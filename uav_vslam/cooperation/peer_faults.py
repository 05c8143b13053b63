# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the peers, as far as their packets show: keys, names of two vehicles, clocks, and landmarks."""

from uav_vslam.cooperation.fused_pose import FusedEpoch
from uav_vslam.cooperation.inbox import Inbox
from uav_vslam.types import NS_PER_S


def peer_faults(inbox: Inbox) -> dict[str, str]:
    """Return each current fault of a peer in a line, by subject."""
    faults = {f"keys/{peer}": text for peer, text in sorted(inbox.key_faults.items())}
    for peer, record in sorted(inbox.peers.items()):
        other = record.sessions.contradicting(inbox.now_ns)
        if other is not None:
            faults[f"session/{peer}"] = (
                f"{peer} sends in two sessions at once, {record.sessions.current} and {other}: two vehicles have that "
                f"name, or packets are forged; session {record.sessions.current} is used"
            )
    return faults


def contradictions(epoch: FusedEpoch) -> dict[str, str]:
    """Return a line for each peer whose landmarks contradicted the own estimate at an epoch, by subject."""
    wrong = {
        f"landmarks/{name}": f"landmarks shared with {name} contradict the own estimate, so the fused one is in doubt: "
        "pairs are wrong (fusion.association: consistent leaves them out), or a start state or a calibration is"
        for name in sorted(epoch.contradicting)
    }
    displaced = {
        f"map/{name}": f"the map of {name} is displaced against the own one by more than both claim, so nothing of it "
        "is fused: one of the two start states is wrong, or they have no common origin (fusion.common_origin: false)"
        for name in sorted(epoch.displaced)
    }
    return wrong | displaced


def clocks_ahead(inbox: Inbox) -> dict[str, str]:
    """Return a line for each peer whose clock is far ahead, by subject; its packets are used all the same."""
    return {
        f"clock/{peer}": f"the clock of {peer} is {record.ahead_ns / NS_PER_S:.0f} s ahead: its packets are used as "
        "they arrive"
        for peer, record in sorted(inbox.peers.items())
        if record.ahead_ns
    }


def namesake_fault(inbox: Inbox, vehicle: str) -> str:
    """Return that another vehicle has the own name, in a line, or nothing."""
    sessions = ", ".join(map(str, inbox.namesakes))
    return f"another vehicle called {vehicle} is on the radio (session {sessions}): rename one" if sessions else ""
