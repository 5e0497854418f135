"""What the hooks of a training run share: a place in TorchRL's trainer, and the trainer itself."""

from __future__ import annotations

from typing import Any, ClassVar

from torchrl.trainers import Trainer, TrainerHookBase


class Hook(TrainerHookBase):
    """A hook that is called at one place of the trainer; unless it says otherwise it has nothing to save."""

    place: ClassVar[str]  # where the trainer calls it
    name: ClassVar[str]  # of its state in a checkpoint
    trainer: Trainer  # from `register` on

    def register(self, trainer: Trainer, name: str | None = None) -> None:
        """Have the trainer call it at `place`, and save its state."""
        self.trainer = trainer
        trainer.register_op(self.place, self)
        trainer.register_module(name or self.name, self)

    def state_dict(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Nothing to restore."""
