"""Wattlane's engine: scenario → world → orders → dispatch → plan → traffic → step → energy → log."""
