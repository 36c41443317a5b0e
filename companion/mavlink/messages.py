"""The MAVLink messages that the gate reads, checks or sends: number, name, CRC_EXTRA and what is where on the wire.

Fields are in the order of the wire, with the code of `struct` before each name; extension fields come last. Nobody here
asks for lists of numbers (covariances, quaternions, serial numbers): they are padding before the next code, ``84xB``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Layout:
    """One message.

    Attributes:
        message_id: its number.
        name: as in the MAVLink definitions.
        crc_extra: the byte that goes into the checksum behind the payload, one for each definition.
        fields: names in the order of ``packing``.
        texts: those of them that are characters.
        packing: of the whole payload, extensions included.
    """

    message_id: int
    name: str
    crc_extra: int
    fields: tuple[str, ...]
    texts: tuple[str, ...]
    packing: struct.Struct


_TABLE = """
0 HEARTBEAT 50: I custom_mode B type B autopilot B base_mode B system_status B mavlink_version
1 SYS_STATUS 124: I onboard_control_sensors_present I onboard_control_sensors_enabled
  I onboard_control_sensors_health H load H voltage_battery h current_battery H drop_rate_comm H errors_comm
  H errors_count1 H errors_count2 H errors_count3 H errors_count4 b battery_remaining
  I onboard_control_sensors_present_extended I onboard_control_sensors_enabled_extended
  I onboard_control_sensors_health_extended
11 SET_MODE 89: I custom_mode B target_system B base_mode
20 PARAM_REQUEST_READ 214: h param_index B target_system B target_component 16s param_id
21 PARAM_REQUEST_LIST 159: B target_system B target_component
22 PARAM_VALUE 220: f param_value H param_count H param_index 16s param_id B param_type
23 PARAM_SET 168: f param_value B target_system B target_component 16s param_id B param_type
24 GPS_RAW_INT 24: Q time_usec i lat i lon i alt H eph H epv H vel H cog B fix_type B satellites_visible
  i alt_ellipsoid I h_acc I v_acc I vel_acc I hdg_acc H yaw
30 ATTITUDE 39: I time_boot_ms f roll f pitch f yaw f rollspeed f pitchspeed f yawspeed
32 LOCAL_POSITION_NED 185: I time_boot_ms f x f y f z f vx f vy f vz
33 GLOBAL_POSITION_INT 104: I time_boot_ms i lat i lon i alt i relative_alt h vx h vy h vz H hdg
43 MISSION_REQUEST_LIST 132: B target_system B target_component B mission_type
48 SET_GPS_GLOBAL_ORIGIN 41: i latitude i longitude i altitude B target_system Q time_usec
49 GPS_GLOBAL_ORIGIN 39: i latitude i longitude i altitude Q time_usec
51 MISSION_REQUEST_INT 196: H seq B target_system B target_component B mission_type
69 MANUAL_CONTROL 243: h x h y h z h r H buttons B target H buttons2 B enabled_extensions h s h t
  h aux1 h aux2 h aux3 h aux4 h aux5 h aux6
70 RC_CHANNELS_OVERRIDE 124: H chan1_raw H chan2_raw H chan3_raw H chan4_raw H chan5_raw H chan6_raw H chan7_raw
  H chan8_raw B target_system B target_component H chan9_raw H chan10_raw H chan11_raw H chan12_raw H chan13_raw
  H chan14_raw H chan15_raw H chan16_raw H chan17_raw H chan18_raw
75 COMMAND_INT 158: f param1 f param2 f param3 f param4 i x i y f z H command B target_system B target_component
  B frame B current B autocontinue
76 COMMAND_LONG 152: f param1 f param2 f param3 f param4 f param5 f param6 f param7 H command B target_system
  B target_component B confirmation
77 COMMAND_ACK 143: H command B result B progress i result_param2 B target_system B target_component
82 SET_ATTITUDE_TARGET 49: I time_boot_ms 16xf body_roll_rate f body_pitch_rate f body_yaw_rate f thrust
  B target_system B target_component B type_mask
84 SET_POSITION_TARGET_LOCAL_NED 143: I time_boot_ms f x f y f z f vx f vy f vz f afx f afy f afz f yaw f yaw_rate
  H type_mask B target_system B target_component B coordinate_frame
86 SET_POSITION_TARGET_GLOBAL_INT 5: I time_boot_ms i lat_int i lon_int f alt f vx f vy f vz f afx f afy f afz f yaw
  f yaw_rate H type_mask B target_system B target_component B coordinate_frame
102 VISION_POSITION_ESTIMATE 158: Q usec f x f y f z f roll f pitch f yaw 84xB reset_counter
103 VISION_SPEED_ESTIMATE 208: Q usec f x f y f z 36xB reset_counter
110 FILE_TRANSFER_PROTOCOL 84: B target_network B target_system B target_component 251x
111 TIMESYNC 34: q tc1 q ts1
147 BATTERY_STATUS 154: i current_consumed i energy_consumed h temperature 20xh current_battery B id
  B battery_function B type b battery_remaining i time_remaining B charge_state 8xB mode I fault_bitmask
148 AUTOPILOT_VERSION 178: Q capabilities Q uid I flight_sw_version I middleware_sw_version I os_sw_version
  I board_version H vendor_id H product_id 42x
193 EKF_STATUS_REPORT 71: f velocity_variance f pos_horiz_variance f pos_vert_variance f compass_variance
  f terrain_alt_variance H flags f airspeed_variance
230 ESTIMATOR_STATUS 163: Q time_usec f vel_ratio f pos_horiz_ratio f pos_vert_ratio f mag_ratio f hagl_ratio
  f tas_ratio f pos_horiz_accuracy f pos_vert_accuracy H flags
245 EXTENDED_SYS_STATE 130: B vtol_state B landed_state
251 NAMED_VALUE_FLOAT 170: I time_boot_ms f value 10s name
253 STATUSTEXT 83: B severity 50s text H id B chunk_seq
331 ODOMETRY 91: Q time_usec f x f y f z 16xf vx f vy f vz f rollspeed f pitchspeed f yawspeed 168xB frame_id
  B child_frame_id B reset_counter B estimator_type b quality
412 REQUEST_EVENT 33: H first_sequence H last_sequence B target_system B target_component
"""


def _layout(text: str) -> Layout:
    """One message of the table."""
    head, _, fields = text.partition(":")
    number, name, crc_extra = head.split()
    words = fields.split()
    codes, names = words[::2], words[1::2]
    texts = [name for code, name in zip(codes, names, strict=False) if code.endswith("s")]
    packing = struct.Struct("<" + "".join(codes))
    return Layout(int(number), name, int(crc_extra), tuple(names), tuple(texts), packing)


LAYOUTS: dict[int, Layout] = {
    layout.message_id: layout for layout in map(_layout, _TABLE.replace("\n  ", " ").strip().splitlines())
}
"""By number."""
NAMES: dict[int, str] = {number: layout.name for number, layout in LAYOUTS.items()}
"""Names by number."""
BY_NAME: dict[str, Layout] = {layout.name: layout for layout in LAYOUTS.values()}
"""By name."""
