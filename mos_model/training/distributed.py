"""The processes of a training run: one, or those that torchrun started."""

import os
from dataclasses import dataclass

import numpy as np
import torch
import torch.distributed as dist
from numpy.typing import NDArray


@dataclass(frozen=True)
class Ranks:
    """This process among `world` processes, and its device."""

    device: torch.device
    rank: int = 0
    world: int = 1

    def sum(self, counts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Sum of the arrays of all processes."""
        if self.world == 1:
            return counts
        total = torch.from_numpy(counts.copy()).to(self.device)
        dist.all_reduce(total)
        return total.cpu().numpy()

    def agree(self, wish: bool) -> bool:
        """Whether any process wishes so; the same answer in all of them."""
        return bool(self.sum(np.array([wish], np.int64))[0]) if self.world > 1 else wish

    def close(self) -> None:
        """Leave the group of processes."""
        if self.world > 1:
            dist.destroy_process_group()


def join_ranks(device: str = "auto") -> Ranks:
    """Join the processes that torchrun started, or be alone. device: "auto", "cpu", "cuda", "cuda:1"."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    if world == 1:
        return Ranks(torch.device(device))
    if device == "cuda":
        device = f"cuda:{os.environ['LOCAL_RANK']}"
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    return Ranks(torch.device(device), dist.get_rank(), world)
