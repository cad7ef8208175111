// @ts-check
// What does every page have?  The live link, pictures, ages, messages, and buttons that are held.
import { startAges } from "./ages.js";
import { startHolding } from "./hold.js";
import { startLive } from "./live.js";
import { startMessages } from "./messages.js";
import "./picture.js";

startMessages();
startAges();
startHolding();
startLive();
