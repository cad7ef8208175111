// @ts-check
// What does every page have?  The live link, pictures, ages, messages, buttons that are held, and parts that stay.
import { startAges } from "./ages.js";
import { startHolding } from "./hold.js";
import { startLive } from "./live.js";
import { startMessages } from "./messages.js";
import { startSteady } from "./steady.js";
import "./picture.js";

startMessages();
startSteady();
startAges();
startHolding();
startLive();
