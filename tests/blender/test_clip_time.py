"""When a clip plays: start frame, speed and keyed Time move nodes, presence, camera, clip, edits and sentences together."""
