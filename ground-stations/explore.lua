-- Explore, for ArduCopter 4.7 or newer with SCR_ENABLE 1. It gives a ground station and the transmitter two things:
--
--   the flight mode "Explore", chosen on the ground: asks the companion computer to start its mission;
--   the auxiliary function 300 (Scripting1): high starts the mission or lets it go on, the middle pauses, low comes home.
--
-- The script asks and nothing else. Whether to fly is decided by the companion computer, which takes GUIDED for it. What
-- it refuses it says itself, and this script says that it was refused.

local MODE, NAME, SHORT = 101, "Explore", "EXPL"
local AUXILIARY = 300

local COMPANION, AUTOPILOT = 191, 1       -- components of this system
local HEARTBEAT, COMMAND_LONG, COMMAND_ACK = 0, 76, 77
local START, PAUSE_CONTINUE, HOME = 300, 193, 20
local NAMES = { [START] = "start", [PAUSE_CONTINUE] = "pause", [HOME] = "home" }
local RESULTS = { [1] = "not now", [2] = "denied", [3] = "unsupported", [4] = "failed" }
local ACCEPTED, IN_PROGRESS = 0, 5
local WARNING, NOTICE = 4, 5

local PERIOD_MS = 100
local HEARD_MS = 3000                     -- a companion that is silent for longer is none
local AGAIN_MS, ANSWER_MS = 500, 3000     -- a question is asked again so often, and given up after so long
local TAKES_MS = 60000                    -- the companion may check once more before it takes the vehicle
local SETTLES_MS = 1500                   -- after the transmitter was lost its switches may stand anywhere

local HEADER = "<HBBBBBBBI3"              -- of a message as the autopilot hands it over: sender and number are in it
local HEADER_BYTES = string.packsize(HEADER)

local mode = assert(vehicle:register_custom_mode(MODE, NAME, SHORT), "Explore: mode number " .. MODE .. " is taken")
mavlink:init(10, 2)
mavlink:register_rx_msgid(HEARTBEAT)
mavlink:register_rx_msgid(COMMAND_ACK)

local channel, heard_ms                   -- where the companion computer was heard, and when
local question                            -- what was asked and is not answered yet
local last_mode, before_mode, entered_ms
local last_level, received, settles_ms = nil, false, 0

local function now_ms()
  return millis():toint()
end

local function say(severity, words)
  gcs:send_text(severity, "Explore: " .. words)
end

local function is_there()
  return heard_ms ~= nil and now_ms() - heard_ms < HEARD_MS
end

local function listen()
  while true do
    local message, from = mavlink:receive_chan()
    if message == nil then
      return
    end
    local _, _, length, _, _, _, system, component, number = string.unpack(HEADER, message)
    if system == param:get("MAV_SYSID") and component == COMPANION then
      if number == HEARTBEAT then
        channel, heard_ms = from, now_ms()
      elseif number == COMMAND_ACK and question ~= nil and length >= 2 then
        -- Zeros at the end of a payload are left out on the way.
        local payload = message:sub(HEADER_BYTES + 1, HEADER_BYTES + length) .. string.rep("\0", 10)
        local command, result, _, _, to_system, to_component = string.unpack("<HBBi4BB", payload)
        if command == question.command and to_system == system and to_component == AUTOPILOT
            and result ~= IN_PROGRESS then
          local answered = question
          question = nil
          answered.on_answer(result)
        end
      end
    end
  end
end

local function send()
  question.sent_ms = now_ms()
  mavlink:send_chan(channel, COMMAND_LONG, string.pack("<fffffffHBBB", question.parameter, 0, 0, 0, 0, 0, 0,
    question.command, math.floor(param:get("MAV_SYSID")), COMPANION, 0))
end

local function ask(command, parameter, on_answer)
  if not is_there() then
    on_answer(nil)
    return
  end
  question = { command = command, parameter = parameter, on_answer = on_answer, began_ms = now_ms() }
  send()
end

local function ask_again()
  if question == nil then
    return
  end
  if now_ms() - question.began_ms > ANSWER_MS then
    local unanswered = question
    question = nil
    unanswered.on_answer(nil)
  elseif now_ms() - question.sent_ms > AGAIN_MS then
    send()
  end
end

local function tell(command, result)
  if result == nil then
    say(WARNING, NAMES[command] .. ": the companion is not heard")
  elseif result ~= ACCEPTED then
    say(WARNING, NAMES[command] .. ": " .. (RESULTS[result] or "refused"))
  end
end

-- The mode.

local function leave(words)
  say(WARNING, words)
  if before_mode == nil or not vehicle:set_mode(before_mode) then
    say(WARNING, "choose another mode")
  end
end

local function enter()
  entered_ms = now_ms()
  if before_mode == nil then
    leave("it was on when the script started")
    return
  end
  ask(START, 0, function(result)
    tell(START, result)
    if result == ACCEPTED then
      say(NOTICE, "started")
    elseif vehicle:get_mode() == MODE then
      leave("back to the mode before")
    end
  end)
end

local function follow_mode()
  -- In the air the companion has the vehicle, or somebody else: nobody takes it by choosing this.
  mode:allow_entry(is_there() and not arming:is_armed())
  local shown = vehicle:get_mode()
  if shown == MODE and last_mode ~= MODE then
    before_mode = last_mode
    enter()
  elseif shown == MODE and question == nil and not arming:is_armed() and now_ms() - entered_ms > TAKES_MS then
    entered_ms = now_ms()
    leave("nothing came of it")
  end
  last_mode = shown
end

-- The switch.

local function follow_switch()
  local receives = rc:has_valid_input()
  if receives and not received then
    settles_ms = now_ms() + SETTLES_MS
  end
  received = receives
  local level = rc:get_aux_cached(AUXILIARY)
  if level == nil or level == last_level then
    return
  end
  local first, unseen = last_level == nil, now_ms() < settles_ms
  last_level = level
  local armed = arming:is_armed()
  if level == 2 then
    if first or unseen then
      say(WARNING, "the switch is on, switch it off")
    elseif armed then
      ask(PAUSE_CONTINUE, 1, function(result) tell(PAUSE_CONTINUE, result) end)
    else
      ask(START, 0, function(result) tell(START, result) end)
    end
  elseif armed and not first then
    local command = level == 1 and PAUSE_CONTINUE or HOME
    ask(command, 0, function(result) tell(command, result) end)
  end
end

local function update()
  listen()
  ask_again()
  follow_mode()
  follow_switch()
  return update, PERIOD_MS
end

say(NOTICE, "mode " .. MODE .. " is there")
return update()
