// Frames on the disk until no take needs them any more.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Threading;

namespace Mocapella.KinectV2
{
    /// <summary>The frames of one run that are not acknowledged: files of consecutive length-delimited messages.
    ///
    /// Each frame is written before it is sent, so that it outlives this process. When the spool is full, its oldest
    /// file is deleted, and the frames in it are lost. All methods may be called on any thread.</summary>
    public sealed class Spool : IDisposable
    {
        private const int FramesPerFile = 600;
        private const string Ending = ".frames", Mark = "acknowledged", ClockFile = "clock", LockFile = "lock";

        private sealed class Part
        {
            public long First;
            public int Count;
            public long Bytes;
            public string Path;
            public long After { get { return First + Count; } }
        }

        private readonly object gate = new object();
        private readonly List<Part> parts = new List<Part>();
        private readonly FileStream held;
        private readonly long mostBytes, reserveBytes;
        private readonly Action<string> say;
        private FileStream writer, reader;
        private Part readerPart;
        private long readerNext, bytes, clockShiftNs, beganTicks;
        private bool full, failing;

        /// <summary>Spools of earlier runs: they count for the limits, too, and are lost before this one's.</summary>
        public readonly List<Spool> Earlier = new List<Spool>();
        public readonly string Folder;
        public readonly ulong NodeId;
        /// <summary>Frames that were deleted or could not be written, before they were acknowledged.</summary>
        public long Dropped { get; private set; }
        /// <summary>Number of the next frame.</summary>
        public long Next { get; private set; }
        /// <summary>Every frame below this number is acknowledged.</summary>
        public long Acknowledged { get; private set; }

        /// <summary>Make the spool of a new run.</summary>
        public Spool(string root, string sensor, ulong nodeId, long mostBytes, long reserveBytes, Action<string> say)
        {
            NodeId = nodeId;
            Folder = Path.Combine(root, Name(sensor, nodeId));
            this.mostBytes = mostBytes;
            this.reserveBytes = reserveBytes;
            this.say = say;
            Directory.CreateDirectory(Folder);
            held = Held(Folder);
            string clock = MonotonicClock.NowNs().ToString(CultureInfo.InvariantCulture) + " "
                + DateTime.UtcNow.Ticks.ToString(CultureInfo.InvariantCulture);
            File.WriteAllText(Path.Combine(Folder, ClockFile), clock);
        }

        private Spool(string folder, ulong nodeId, FileStream held, Action<string> say)
        {
            Folder = folder;
            NodeId = nodeId;
            this.held = held;
            this.say = say;
        }

        /// <summary>Return the spools that earlier runs of this sensor have left, the oldest first.</summary>
        public static List<Spool> Left(string root, string sensor, Action<string> say)
        {
            var found = new List<Spool>();
            if (!Directory.Exists(root)) return found;
            var folders = new DirectoryInfo(root).GetDirectories(sensor + "-*");
            foreach (var folder in folders)
            {
                ulong nodeId;
                string id = folder.Name.Substring(sensor.Length + 1);
                if (id.Length != 16
                    || !ulong.TryParse(id, NumberStyles.AllowHexSpecifier, CultureInfo.InvariantCulture, out nodeId))
                    continue;
                var spool = Reopened(folder.FullName, nodeId, say);
                if (spool != null) found.Add(spool);
            }
            found.Sort((a, b) => a.beganTicks.CompareTo(b.beganTicks));
            return found;
        }

        private static Spool Reopened(string folder, ulong nodeId, Action<string> say)
        {
            FileStream held;
            try
            {
                held = Held(folder);
            }
            catch (IOException) // its client runs
            {
                return null;
            }
            var spool = new Spool(folder, nodeId, held, say);
            try
            {
                spool.Load();
            }
            catch (Exception error)
            {
                if (!(error is IOException || error is UnauthorizedAccessException || error is FormatException)) throw;
                say("the frames in " + folder + " cannot be read (" + error.Message + "); they stay there");
                spool.Dispose();
                return null;
            }
            if (spool.parts.Count > 0) return spool;
            spool.Remove();
            return null;
        }

        /// <summary>Open the file that claims the folder for this program; IOException if another one has it.</summary>
        private static FileStream Held(string folder)
        {
            var file = new FileStream(
                Path.Combine(folder, LockFile), FileMode.OpenOrCreate, FileAccess.ReadWrite, FileShare.None);
            try
            {
                file.Lock(0, 1); // on Linux, where Mono shares the file with other processes all the same
                return file;
            }
            catch (IOException)
            {
                file.Dispose();
                throw;
            }
        }

        private void Load()
        {
            string mark = Path.Combine(Folder, Mark), clock = Path.Combine(Folder, ClockFile);
            if (!File.Exists(mark)) mark += ".new"; // killed between two steps of WriteMark
            if (File.Exists(mark)) Acknowledged = long.Parse(File.ReadAllText(mark), CultureInfo.InvariantCulture);
            var words = File.Exists(clock) ? File.ReadAllText(clock).Split(' ') : new string[0];
            if (words.Length == 2) // a machine that has started again has another monotonic clock
            {
                long began = long.Parse(words[0], CultureInfo.InvariantCulture);
                beganTicks = long.Parse(words[1], CultureInfo.InvariantCulture);
                clockShiftNs = began + (DateTime.UtcNow.Ticks - beganTicks) * 100 - MonotonicClock.NowNs();
            }
            var files = Directory.GetFiles(Folder, "*" + Ending);
            Array.Sort(files, string.CompareOrdinal);
            foreach (var path in files)
            {
                var part = new Part { Path = path };
                part.First = long.Parse(Path.GetFileNameWithoutExtension(path), CultureInfo.InvariantCulture);
                using (var file = new FileStream(path, FileMode.Open, FileAccess.Read))
                    while (ReadMessage(file) != null)
                    {
                        part.Count++;
                        part.Bytes = file.Position;
                    }
                if (part.Count > 0) parts.Add(part);
                bytes += part.Bytes;
                Next = Math.Max(Next, part.After);
            }
            Acknowledged = Math.Min(Acknowledged, Next);
        }

        /// <summary>Number of the oldest frame that is available; `Next` if there is none.</summary>
        public long First
        {
            get
            {
                lock (gate)
                    foreach (var part in parts)
                        if (part.After > Acknowledged)
                            return Math.Max(part.First, Acknowledged);
                return Next;
            }
        }

        /// <summary>Number of frames that are kept and not acknowledged.</summary>
        public long Waiting
        {
            get
            {
                long count = 0;
                lock (gate)
                    foreach (var part in parts)
                        count += Math.Max(0, part.After - Math.Max(part.First, Acknowledged));
                return count;
            }
        }

        /// <summary>Return the present time on the monotonic clock of this spool's frames [ns].</summary>
        public long NowNs()
        {
            return Math.Max(0, MonotonicClock.NowNs() + clockShiftNs);
        }

        /// <summary>Write the next frame, which `encode` makes of its number.</summary>
        public void Append(Func<long, byte[]> encode)
        {
            lock (gate)
            {
                long number = Next;
                var message = BodyMessage.Delimited(encode(number));
                Next = number + 1;
                try
                {
                    MakeRoom(message.Length);
                    Part part = writer == null ? null : parts[parts.Count - 1];
                    bool whole = part != null && (part.Count >= FramesPerFile || part.Bytes > mostBytes / 8);
                    if (part == null || whole || part.After != number) part = Begin(number);
                    writer.Write(message, 0, message.Length);
                    writer.Flush(); // to the system: from here on it outlives this process
                    part.Count++;
                    part.Bytes += message.Length;
                    bytes += message.Length;
                    if (failing) say("the spool can be written again");
                    failing = false;
                }
                catch (Exception error)
                {
                    if (!(error is IOException || error is UnauthorizedAccessException)) throw;
                    Dropped++;
                    if (!failing)
                        say("PROBLEM: frames are lost, because " + Folder + " cannot be written: " + error.Message);
                    failing = true;
                    Seal();
                }
                Monitor.PulseAll(gate);
            }
        }

        private Part Begin(long number)
        {
            Seal();
            string name = number.ToString("D19", CultureInfo.InvariantCulture) + Ending;
            var part = new Part { First = number, Path = Path.Combine(Folder, name) };
            writer = new FileStream(
                part.Path, FileMode.Create, FileAccess.Write, FileShare.ReadWrite | FileShare.Delete);
            parts.Add(part);
            if (reserveBytes > 0)
                while (FreeBytes() < reserveBytes && (DropOfEarlier() || parts.Count > 1 && DropOldest())) { }
            return part;
        }

        /// <summary>Close the file that is being written; cut off what a failed write may have left in it.</summary>
        private void Seal()
        {
            if (writer == null) return;
            var part = parts[parts.Count - 1];
            try
            {
                if (writer.Length != part.Bytes) writer.SetLength(part.Bytes);
                writer.Dispose();
            }
            catch (IOException)
            {
                // The disk is full or gone: the reader stops at the last whole message.
            }
            writer = null;
            if (part.Count == 0) Delete(part);
        }

        private long FreeBytes()
        {
            return new DriveInfo(Path.GetPathRoot(Path.GetFullPath(Folder))).AvailableFreeSpace;
        }

        private void MakeRoom(int length)
        {
            long used = length + bytes;
            foreach (var spool in Earlier) used += spool.bytes;
            if (used <= mostBytes) return;
            if (DropOfEarlier() || parts.Count > 0 && DropOldest()) MakeRoom(length);
        }

        private bool DropOfEarlier()
        {
            foreach (var spool in Earlier)
                lock (spool.gate)
                    if (spool.parts.Count > 0)
                        return spool.DropOldest();
            return false;
        }

        private bool DropOldest()
        {
            var part = parts[0];
            long lost = Math.Max(0, part.After - Math.Max(part.First, Acknowledged));
            if (parts.Count == 1) Seal();
            WriteMark();
            if (parts.Contains(part)) Delete(part);
            Dropped += lost;
            if (lost > 0 && !full)
                say("PROBLEM: the spool is full, or the disk has too little room; the oldest frames are lost, for now "
                    + lost + " of " + Folder);
            full = full || lost > 0;
            return true;
        }

        /// <summary>Note that every frame below a number is acknowledged; delete files without others.</summary>
        public void Acknowledge(long number)
        {
            lock (gate)
            {
                if (number <= Acknowledged) return;
                Acknowledged = Math.Min(number, Next);
                if (parts.Count == 0 || parts[0].After > Acknowledged || parts[0] == Writing()) return;
                WriteMark();
                while (parts.Count > 0 && parts[0].After <= Acknowledged && parts[0] != Writing()) Delete(parts[0]);
                full = false;
            }
        }

        private Part Writing()
        {
            return writer == null ? null : parts[parts.Count - 1];
        }

        private void WriteMark()
        {
            string path = Path.Combine(Folder, Mark), fresh = path + ".new";
            try
            {
                File.WriteAllText(fresh, Acknowledged.ToString(CultureInfo.InvariantCulture));
                File.Delete(path);
                File.Move(fresh, path);
            }
            catch (IOException)
            {
                // Without it, acknowledged frames are sent again, and the server leaves them out.
            }
        }

        private void Delete(Part part)
        {
            if (readerPart == part) CloseReader();
            parts.Remove(part);
            bytes -= part.Bytes;
            try
            {
                File.Delete(part.Path);
            }
            catch (IOException)
            {
                // It stays until the folder is removed.
            }
        }

        /// <summary>Return a frame; null if it is not available.</summary>
        public byte[] Read(long number)
        {
            lock (gate)
            {
                Part part = null;
                foreach (var one in parts)
                    if (one.First <= number && number < one.After)
                        part = one;
                if (part == null) return null;
                if (readerPart != part || readerNext > number)
                {
                    CloseReader();
                    reader = new FileStream(
                        part.Path, FileMode.Open, FileAccess.Read, FileShare.ReadWrite | FileShare.Delete);
                    readerPart = part;
                    readerNext = part.First;
                }
                byte[] message = null;
                for (; readerNext <= number; readerNext++) message = ReadMessage(reader);
                return message;
            }
        }

        private void CloseReader()
        {
            if (reader != null) reader.Dispose();
            reader = null;
            readerPart = null;
        }

        /// <summary>Wait until there is a frame with this number, or the time is over.</summary>
        public void WaitFor(long number, int milliseconds)
        {
            lock (gate)
                if (Next <= number)
                    Monitor.Wait(gate, milliseconds);
        }

        /// <summary>Delete everything; the spool is closed.</summary>
        public void Remove()
        {
            Dispose();
            try
            {
                Directory.Delete(Folder, true);
            }
            catch (IOException)
            {
                // Another program looks into it; the next start removes it.
            }
        }

        public void Dispose()
        {
            lock (gate)
            {
                CloseReader();
                Seal();
                WriteMark();
                held.Dispose();
            }
        }

        private static string Name(string sensor, ulong nodeId)
        {
            return sensor + "-" + nodeId.ToString("x16", CultureInfo.InvariantCulture);
        }

        /// <summary>Read a message after its length; null if the file ends before it does.</summary>
        private static byte[] ReadMessage(Stream from)
        {
            long length = 0;
            for (int place = 0, read = 0x80; (read & 0x80) != 0; place++)
            {
                read = from.ReadByte();
                if (read < 0 || place > 4) return null;
                length |= (long)(read & 0x7F) << 7 * place;
            }
            if (length > 16777216) return null;
            var message = new byte[length];
            for (int have = 0; have < length;)
            {
                int count = from.Read(message, have, (int)length - have);
                if (count == 0) return null;
                have += count;
            }
            return message;
        }
    }
}
