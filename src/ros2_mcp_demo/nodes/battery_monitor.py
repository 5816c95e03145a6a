"""/battery_monitor: the state of the battery."""

# pyright: basic
from __future__ import annotations

import math

from sensor_msgs.msg import BatteryState

from ..battery import CAPACITY_AH, CELLS
from .part import ERROR, OK, WARN, RobotPart


class BatteryMonitor(RobotPart):
    """Publishes the charge once a second."""

    def __init__(self, robot, namespace):
        super().__init__("battery_monitor", robot, namespace)
        description = "How many times faster than a real battery it discharges"
        self.declare_number("drain_rate", 1.0, 0.0, 1000.0, description)
        self._publisher = self.create_publisher(BatteryState, "battery_state", 10)

    def tick(self, stamp):
        """Publish when it is due."""
        self.robot.battery.drain_rate = self.setting("drain_rate")
        if self.is_due(1.0):
            self._publisher.publish(self._message(stamp))

    def diagnosis(self):
        """Return whether the battery is low."""
        battery = self.robot.battery
        values = {"charge [%]": f"{battery.charge * 100:.1f}", "voltage [V]": f"{battery.voltage:.2f}"}
        if battery.charge <= 0.05:
            return ERROR, "battery is empty" if battery.charge == 0.0 else "battery is almost empty", values
        if battery.charge <= 0.2:
            return WARN, "battery is low", values
        return OK, "battery is charged", values

    def _message(self, stamp):
        battery = self.robot.battery
        message = BatteryState(present=True, location="base", serial_number="BT-3S5000-88")
        self.headed(message, stamp, "base_link")
        message.voltage, message.current = battery.voltage, -battery.current
        message.percentage, message.charge = battery.charge, battery.charge * CAPACITY_AH
        message.capacity = message.design_capacity = CAPACITY_AH
        message.temperature = 25.0 + abs(battery.current)
        message.cell_voltage = [battery.voltage / CELLS] * CELLS
        message.cell_temperature = [math.nan] * CELLS
        charging, discharging = (
            BatteryState.POWER_SUPPLY_STATUS_CHARGING,
            BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        )
        message.power_supply_status = charging if battery.is_charging else discharging
        message.power_supply_health = BatteryState.POWER_SUPPLY_HEALTH_GOOD
        message.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LION
        return message
